"""Shows the map of a run, or the keyframes of a map, in a window of Open3D or in Rerun's viewer."""
