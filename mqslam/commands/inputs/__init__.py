"""What commands are given: recordings, settings, trajectories, mounts and covariances."""
