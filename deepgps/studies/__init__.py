"""Studies: many runs from one YAML file, planned here and collected in one table.

``engine`` carries out the runs; ``reports`` turns their results into text and figures.
"""
