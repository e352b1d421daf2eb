"""What keeps a command from doing harm and from coming to harm: locks, names of its own files, bounds of memory."""
