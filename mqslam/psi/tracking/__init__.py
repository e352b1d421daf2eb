"""Odometry by psi: scan after scan over a running map."""
