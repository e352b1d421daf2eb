"""A GNSS receiver beside the radar: its fixes held against the trajectory, and joined to the pose graph."""
