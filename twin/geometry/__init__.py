"""Closed triangulated surfaces: reading, checking, and measuring distances. Knows nothing of
sensors or elasticity.
"""
