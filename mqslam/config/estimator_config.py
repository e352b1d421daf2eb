"""Settings of the estimator's score and its minimiser."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class EstimatorConfig(BaseModel):
    """Settings of the score that the estimator minimises, and of the way it does so."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    s: float = Field(0.6, gt=0.0, description="neighbours farther than this take no part, at the end of annealing [m]")
    s_start: float = Field(2.5, gt=0.0, description="the same at the start of annealing [m]")
    beta_s: float = Field(0.25, gt=0.0, description="width of the spatial kernel at the end [m]")
    beta_s_start: float = Field(1.25, gt=0.0, description="the same at the start [m]")
    c: float = Field(1.5, gt=0.0, description="offset that quarters a point's weight at the end [standard deviations]")
    c_start: float = Field(5.0, gt=0.0, description="the same at the start [standard deviations]")
    shrink: float = Field(0.6, gt=0.0, lt=1.0, description="factor on the widths from step to step")
    steps: int = Field(12, ge=1, description="most Newton steps")
    beta_t: float = Field(0.06, gt=0.0, description="fade of pairs less than one turn apart [s]")
    xi: float = Field(0.02, gt=0.0, lt=1.0, description="least kappa of a selected neighbour")
    blur_m: float = Field(0.15, ge=0.0, description="scatter of one object's returns between views, isotropic [m]")
    sigma_range_m: float = Field(0.15, gt=0.0, description="error of a return along the ray [m]")
    sigma_azimuth: float = Field(0.008, gt=0.0, description="error of a return across the ray [rad]")
    stabiliser: float = Field(
        0.15, ge=0.0, description="share of Gauss-Newton curvature added to the re-selecting curvature, to keep steps safe"
    )
    correlation: float = Field(
        10.0, ge=1.0, description="returns that repeat one another: information is divided by this against a prior"
    )

    search_pixel: float = expert(
        0.3,
        gt=0.0,
        description="Side of a pixel of the images that the global search of a pose correlates, as a share of s_start: "
        "what the minimiser surely bridges.",
    )
    search_same: float = expert(2.0, gt=0.0, description="Poses that are nearer than this many of those pixels are one.")
    search_blur: float = expert(1.4, ge=0.0, description="Standard deviation of the images' blur, in those pixels.")
    search_extent: float = expert(
        110.0,
        gt=0.0,
        description="Points farther from the query's origin than this many pixels take no part in the search: they would "
        "ask for finer yaws.",
    )
    search_peaks: int = expert(3, ge=1, description="Most poses that the global search hands on to the minimiser.")

    @property
    def search_pixel_m(self) -> float:
        """Side of a pixel of the global search [m]."""
        return self.search_pixel * self.s_start

    @property
    def search_same_m(self) -> float:
        """Distance below which two poses of the global search are one [m]."""
        return self.search_same * self.search_pixel_m
