"""Tetrahedra of a body: made, checked, stored, read."""
