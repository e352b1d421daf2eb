"""Guards that keep a command from doing and taking harm: locks, bounds of memory, separate processes for hostile files."""
