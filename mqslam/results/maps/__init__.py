"""Results of commands that take maps which runs have left."""
