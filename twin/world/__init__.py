"""What happens: mesh, elasticity, contact, picture. Holds the truth; never imported by
twin.sense.
"""
