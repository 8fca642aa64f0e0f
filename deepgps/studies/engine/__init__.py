"""The engine: carries out a study's runs, here or on a Ray cluster, and shares recordings and features among them.

It knows nothing of reports and does not judge results.
"""
