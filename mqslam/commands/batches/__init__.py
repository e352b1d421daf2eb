"""What many runs are planned and scheduled by."""
