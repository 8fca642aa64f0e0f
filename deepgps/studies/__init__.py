"""Studies: one scenario and what varies in it, run as many runs, gathered into one table and its report."""
