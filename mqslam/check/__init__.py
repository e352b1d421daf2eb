"""Checks whether a recording contradicts the assumptions under which it was read."""
