"""Reports of studies: records of tables, figures and pictures (``record``), and what makes them of rows (``render``).

Reports read the study's table; they open the runs only for pictures and for their own columns.
"""
