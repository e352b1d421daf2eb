"""From polar scans to returns."""
