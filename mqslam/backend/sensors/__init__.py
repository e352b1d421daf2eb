"""The sensors besides the radar: each is compared with the front end's motions, calibrated, and joined to the pose graph."""
