"""Odometry by psi: each scan is matched to a running map."""
