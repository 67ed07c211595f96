"""Datasets: presses with their truth, in files that other programs read, reproducible sample by
sample.
"""
