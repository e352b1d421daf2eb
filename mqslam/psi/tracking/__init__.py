"""Tracks a recording by psi: matches each scan to a running map of the last keyframes."""
