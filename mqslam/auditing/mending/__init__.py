"""Mending: corrects a trajectory by what its audit has found, in a pose graph."""
