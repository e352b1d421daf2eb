"""Front ends: windows of returns in, relative motions out, one file each; see `mqslam.core.frontend` for the protocol."""
