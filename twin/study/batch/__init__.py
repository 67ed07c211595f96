"""What datasets and sweeps share: drawing values, running tasks on one machine or many, files that
survive.
"""
