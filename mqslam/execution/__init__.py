"""Execution of the work, and storage of its results: engines, checkpoints, interrupts, and files that are written whole."""
