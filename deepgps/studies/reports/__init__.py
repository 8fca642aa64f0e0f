"""Reports and figures of studies, one module for each kind.

Reports read the study's table; they open the runs only for pictures and for their own columns.
"""
