"""The interactive part of the pages: a map that pans and zooms, curves over time, and the place that was clicked."""
