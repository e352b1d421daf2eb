"""Windows: the map of a few successive scans, compared with the best map of the same scans."""
