"""The figures of all pages, and what they are drawn on."""
