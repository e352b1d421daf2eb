"""The velocity that chirps measure without a map: calibrated by psi, and joined to the pose graph."""
