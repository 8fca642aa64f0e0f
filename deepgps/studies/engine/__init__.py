"""Carries out the runs of a study, on this machine or on a Ray cluster, and shares recordings and trainings among them.

It knows no report and judges no result.
"""
