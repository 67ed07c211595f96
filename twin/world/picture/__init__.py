"""What the CCD sees of it: light, rays, outlines, counts."""
