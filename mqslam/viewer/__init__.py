"""Shows the map of a run in a window of Open3D or in Rerun's viewer."""
