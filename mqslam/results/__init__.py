"""Writes the result files of commands: a module each for run, audit, compare, batch, merge and localise."""
