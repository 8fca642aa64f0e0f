"""The initial map: positions from feature similarity and distances, before any network is trained, without truth."""
