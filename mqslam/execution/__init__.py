"""Where work is done and how its results are kept: engines, checkpoints, interrupts, and files written whole."""
