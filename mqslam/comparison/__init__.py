"""Compares front ends on one recording, with the same returns, the same back end and the same audit."""
