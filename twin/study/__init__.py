"""Puts the parts together: recipes, Sensor, run, calibrate."""
