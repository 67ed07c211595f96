"""Sweeps: many designs of a sensor, each judged by a closed form, by its linear information, or by
the full chain.
"""
