"""Audits of maps: how far a map is from the best map of the same points, in every window and at every revisit."""
