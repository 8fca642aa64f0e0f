"""The commands, one file each: its arguments and the function that carries it out.

Packages that take a second to import are imported inside these functions, so that wrong arguments are told at once.
"""
