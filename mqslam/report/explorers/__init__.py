"""The map to move in, on every page of the report."""
