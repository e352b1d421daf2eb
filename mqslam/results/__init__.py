"""Writes the result files of commands: one module for each of run, audit, compare, batch, merge and localise."""
