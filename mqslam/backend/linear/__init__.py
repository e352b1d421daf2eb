"""Linear algebra of a pose graph: its elimination, and the covariances that follow from it."""
