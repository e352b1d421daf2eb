"""Many recordings at once: what is to be run, running it, and one report over all."""
