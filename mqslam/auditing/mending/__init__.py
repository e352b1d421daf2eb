"""Mends a trajectory: corrects the errors that its audit has found, in a pose graph."""
