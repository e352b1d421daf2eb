"""Windows: a few scans in a row, whose map is compared with its own best and with the map under smoothed poses."""
