"""Commands that take maps which runs have left."""
