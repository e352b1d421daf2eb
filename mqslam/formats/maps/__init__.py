"""Reads and writes maps: occupancy grids, keyframes, and georeferenced maps."""
