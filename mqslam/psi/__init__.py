"""The map-quality score psi: as published, the estimator's form of it, its minimiser and its covariance."""
