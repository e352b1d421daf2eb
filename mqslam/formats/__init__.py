"""File formats: recordings, trajectories, clouds, odometry."""
