"""Runs the work of commands and stores the results: engines, checkpoints, interrupts, and files complete or absent."""
