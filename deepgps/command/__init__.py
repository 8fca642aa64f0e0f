"""What all commands share: signals, output streams, the terminal, and the line that explains a failure.

Nothing here depends on what a command computes.
"""
