"""A gyroscope beside the radar: held against psi's motions, calibrated, and joined to the pose graph."""
