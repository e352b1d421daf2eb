"""What every layer speaks of: SE(2), motions, recordings, scans, measurements, trajectories, maps."""
