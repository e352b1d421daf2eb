"""Loop closures: finds places that were passed twice, and registers the two passes by psi."""
