"""Files of maps: occupancy grids, keyframes, and georeferenced maps."""
