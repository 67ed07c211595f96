"""Closed forms, used by both wings and by the tests."""
