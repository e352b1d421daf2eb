"""Graphs of one's own: factors for a GTSAM graph that someone else builds, and graphs in files."""
