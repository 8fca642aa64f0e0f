"""The viewer's window: the package finds the viewer and opens it on the desktop or serves it as a web page.

Its sibling packages decide what the window shows.
"""
