"""Merging: several results become one map, by the places that their recordings share."""
