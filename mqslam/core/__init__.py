"""The geometry and data types that all layers share: SE(2), motions, recordings, scans, measurements, trajectories, maps."""
