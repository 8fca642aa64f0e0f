"""Pieces of furniture, fittings and decoration as MuJoCo geoms with procedural textures.

Each piece is built at the origin; ``sim.rooms`` decides where it goes.
"""
