"""Spans: registrations of scans some tens of metres of path apart, and the errors of a trajectory that they show."""
