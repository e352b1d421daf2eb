"""The sensors besides the radar: compares each with the radar's motions, calibrates it, and joins it to the pose graph."""
