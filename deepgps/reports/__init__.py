"""Figures, tables and reports of one run.

Results come from ``deepgps.evaluation``; nothing here computes or selects results.
"""
