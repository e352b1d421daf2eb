"""Settings of the estimator's score and its minimiser."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class EstimatorConfig(BaseModel):
    """Settings of the score that the estimator minimises, and of the way it does so."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    s: float = Field(0.6, gt=0.0, description="Distance beyond which neighbours take no part, at the end of annealing [m].")
    s_start: float = Field(
        2.5, gt=0.0, description="Distance beyond which neighbours take no part, at the start of annealing [m]."
    )
    beta_s: float = Field(0.25, gt=0.0, description="Width of the spatial kernel at the end of annealing [m].")
    beta_s_start: float = Field(1.25, gt=0.0, description="Width of the spatial kernel at the start of annealing [m].")
    blur_m: float = Field(
        0.15,
        ge=0.0,
        description="Standard deviation by which the returns of one object scatter between views, in any direction [m].",
    )
    sigma_range_m: float = Field(0.15, gt=0.0, description="Standard deviation of a return along the ray [m].")
    sigma_azimuth: float = Field(0.008, gt=0.0, description="Standard deviation of a return across the ray [rad].")
    cluster_m: float = expert(
        2.0,
        gt=0.0,
        description="Side of the cells [m] within which returns count as one object in the covariance of a minimum, "
        "because their errors are common.",
    )
