"""Localises a recording in the map of another recording."""
