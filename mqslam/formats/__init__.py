"""Reads and writes files: recordings, sensors, trajectories, covariances, pose graphs, maps and point clouds."""
