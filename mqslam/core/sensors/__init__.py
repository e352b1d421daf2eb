"""What other sensors beside the radar deliver, and where they sit on the vehicle."""
