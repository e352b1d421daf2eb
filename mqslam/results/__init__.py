"""What a run, an audit, a comparison and a batch leave on disk: one module each."""
