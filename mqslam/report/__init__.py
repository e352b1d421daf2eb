"""Makes the pages of all commands; each page is one HTML file that loads nothing else, and all share one template."""
