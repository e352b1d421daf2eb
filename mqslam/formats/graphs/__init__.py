"""Files of pose graphs."""
