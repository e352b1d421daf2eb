"""Mending: the corrections that an audit asks for, put into the trajectory through a pose graph."""
