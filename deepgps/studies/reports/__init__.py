"""Reports and figures of studies, one module for each kind.

They read the study's table; the runs are opened only for pictures.
"""
