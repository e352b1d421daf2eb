"""Front ends: scans in, relative motions out, one file each; see `mqslam.core.frontend` for the protocol."""
