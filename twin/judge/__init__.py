"""Sees both truth and estimate, and says how far apart they are."""
