"""The pose graph and what it is built from."""
