"""What all commands share: signals, output streams, the console, and the line that explains a failure.

Nothing here depends on what a command computes.
"""
