"""Factors: a measurement in, a GTSAM factor out, one kind per file."""
