"""Maps of cells, and what places them on the Earth."""
