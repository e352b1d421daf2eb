"""Offers the commands as Python functions, which print nothing and parse no arguments."""
