"""Renders maps and keyframes from scans along a trajectory, and computes occupancy grids and measures of map quality."""
