"""Factors of the pose graph: functions that turn a measurement into a GTSAM factor, one kind of measurement per file."""
