"""The recording that shows two runs of one room and their difference.

It reads runs that are complete and writes nothing into them.
"""
