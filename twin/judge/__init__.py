"""Sees both truth and estimate, and computes how far apart they are."""
