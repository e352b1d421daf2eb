"""Front ends, which turn scans into relative motions, one file each; `mqslam.core.frontend` holds the protocol."""
