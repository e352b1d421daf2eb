"""Files of maps: occupancy grids, keyframes, and maps with their place on the Earth."""
