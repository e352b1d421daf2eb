"""Statistics that several stages need."""
