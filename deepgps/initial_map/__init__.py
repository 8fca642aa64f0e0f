"""The initial map: features' neighbours and distances driven become positions before any network is trained.

The truth is never opened here, and no network is trained.
"""
