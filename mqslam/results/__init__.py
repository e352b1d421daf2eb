"""What run, audit, compare and batch leave on disk."""
