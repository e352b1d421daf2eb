"""The map-quality score psi: its published form, the estimator's form, the minimiser and the covariance."""
