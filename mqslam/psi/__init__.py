"""Computes and minimises the map-quality score psi, estimates the covariance of its minimum, and tracks scans by it."""
