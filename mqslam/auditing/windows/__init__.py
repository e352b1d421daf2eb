"""Compares the map of a few successive scans (a window) with the best map of the same scans."""
