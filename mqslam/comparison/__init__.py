"""Comparing front ends on one recording: the same returns, the same back end, the same judges."""
