"""Spans: scans some path apart, laid on each other, and what they ask for: all of them together, and each alone."""
