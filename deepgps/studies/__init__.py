"""Studies: many runs from one YAML file, planned here and collected in one table.

How runs are carried out is in ``engine``, what is said about them in ``reports``.
"""
