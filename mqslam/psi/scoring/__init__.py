"""The score of points: their neighbours, one offset per point, and what a minimiser needs of it."""
