"""The commands of `twin`, one a file: arguments in, one call into `twin.study` or `twin.show`,
lines out.
"""
