"""Recordings and results in the layouts of others: one module per layout."""
