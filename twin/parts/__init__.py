"""What the sensor is: frozen, validated descriptions. Nothing here computes physics or imports a
heavy package.
"""
