"""Dead reckoning beside the radar: calibrated by psi, and joined to the pose graph."""
