"""The commands, one file each: its arguments and the function that carries it out.

Slow packages are imported inside these functions, so that wrong arguments are reported at once.
"""
