"""The initial map: positions from feature similarity and distances travelled, before any network is trained.

Nothing here opens the ground truth or trains a network.
"""
