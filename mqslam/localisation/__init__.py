"""Localisation: the poses of a recording in the map of another one."""
