"""The papers' tables and figures, each computed through the whole chain, paper next to twin."""
