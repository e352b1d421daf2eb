"""A look at a map: what is to be shown, in an Open3D window or in Rerun's viewer."""
