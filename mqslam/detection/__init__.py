"""The first stage of a run: detects a radar's returns and measures its velocity, or resamples the scans of a lidar."""
