"""What sensors deliver beside scans, what is detected in it, and where they sit on the vehicle."""
