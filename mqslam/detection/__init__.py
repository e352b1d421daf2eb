"""Detects the returns of polar scans, and measures the sensor's velocity from alternating chirps."""
