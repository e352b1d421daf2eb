"""Loop closures: places passed twice, tied by psi."""
