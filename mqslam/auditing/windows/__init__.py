"""Windows: a few scans in a row, held against their own best map and against the map of smoother poses."""
