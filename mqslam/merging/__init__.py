"""Merges several results into one map, by the places that their recordings share."""
