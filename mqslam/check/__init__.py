"""Whether a recording contradicts what was assumed to read it."""
