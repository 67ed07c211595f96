"""The papers' tables and figures, each made again through the whole chain, paper beside twin."""
