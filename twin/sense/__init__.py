"""The sensor's software: pictures in, forces out. Blind to the truth: imports nothing of
twin.world.
"""
