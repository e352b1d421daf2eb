"""Protection of outputs, memory and the main process: locks, bounds of memory, separate processes for untrusted files."""
