"""What the pages are made from: a run, an audit and a comparison as their pages show them."""
