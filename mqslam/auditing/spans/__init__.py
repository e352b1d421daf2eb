"""Spans: registrations of scans some path apart, and the corrections that they ask for, all together and each alone."""
