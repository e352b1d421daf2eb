"""Where work is done, and what keeps its results: engines, checkpoints, interrupts, whole files."""
