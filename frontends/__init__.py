"""Front ends: windows of returns in, relative motions out, one file each; see `mqslam.frontend` for the protocol."""
