"""Registers scans with some tens of metres of path between them (spans), and estimates the errors that spans show."""
