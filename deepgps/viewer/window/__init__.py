"""The viewer's window: found, opened on the desktop or served as a web page.

What is drawn in it is decided by its neighbours.
"""
