"""Auditing a map: how far it is from its own best, window by window and where the trajectory comes back."""
