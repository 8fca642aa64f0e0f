"""What every command does at its edges: signals, output streams, terminal, and the line that explains a failure.

Nothing here knows what a command computes.
"""
