"""Runs the work of commands and stores the results: engines, checkpoints, interrupts, and complete files or none."""
