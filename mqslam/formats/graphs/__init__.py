"""Reads pose graphs in the formats of g2o and GTSAM, and writes them in the format of g2o."""
