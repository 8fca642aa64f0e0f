"""The Python interface: ``import deepgps`` offers these functions and classes, and imports them when they are used."""
