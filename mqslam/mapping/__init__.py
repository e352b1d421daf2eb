"""Maps rendered from scans along a trajectory."""
