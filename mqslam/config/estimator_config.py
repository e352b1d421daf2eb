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
    c: float = Field(
        1.5,
        gt=0.0,
        description="Offset at which a point's weight has fallen to a quarter, at the end of annealing "
        "[standard deviations].",
    )
    c_start: float = Field(
        5.0,
        gt=0.0,
        description="Offset at which a point's weight has fallen to a quarter, at the start of annealing "
        "[standard deviations].",
    )
    steps: int = Field(12, ge=1, description="Largest number of Newton steps.")
    beta_t: float = Field(0.06, gt=0.0, description="Width of the fade of pairs that are less than one turn apart [s].")
    xi: float = Field(0.02, gt=0.0, lt=1.0, description="Least kappa of a selected neighbour.")
    blur_m: float = Field(
        0.15,
        ge=0.0,
        description="Standard deviation by which the returns of one object scatter between views, in any direction [m].",
    )
    apart_share: float = Field(
        0.3,
        gt=0.0,
        le=1.0,
        description="Factor on the weight (kappa) of a neighbour that was seen from a quite different direction. With 1, "
        "all views count the same.",
    )
    apart_blur: float = Field(
        2.0,
        ge=1.0,
        description="Factor on blur_m for a neighbour that was seen from a quite different direction. With 1, all views "
        "scatter the same.",
    )
    sigma_range_m: float = Field(0.15, gt=0.0, description="Standard deviation of a return along the ray [m].")
    sigma_azimuth: float = Field(0.008, gt=0.0, description="Standard deviation of a return across the ray [rad].")
    correlation: float = Field(
        5.0,
        ge=1.0,
        description="Number of returns that tell the same. psi's information is divided by this number where it is "
        "weighed against a prior.",
    )
    cluster_m: float = expert(
        2.0,
        gt=0.0,
        description="Side of the cells [m] within which returns count as one object in the covariance of a minimum, "
        "because their errors are common.",
    )
    observed_share: float = expert(
        0.16,
        gt=0.0,
        lt=1.0,
        description="A direction in which less than this share of Gauss-Newton's curvature remains at the widest scale "
        "counts as not observed: 0.22 and more remain in streets, 0.12 and less along a bare corridor.",
    )
    rival: float = expert(
        1.25,
        ge=1.0,
        description="A motion counts as ambiguous where another one has a psi below this factor times the best one's.",
    )
    different: float = expert(
        25.0,
        gt=0.0,
        description="Squared distance between two motions of a window, in units of their covariances, beyond which they are "
        "different motions.",
    )

    search_pixel: float = expert(
        0.3,
        gt=0.0,
        description="Side of a pixel of the images that the global search of a pose correlates, as a share of "
        "s_start. The minimiser surely bridges that distance.",
    )
    search_same: float = expert(
        2.0,
        gt=0.0,
        description="Poses that are nearer to each other than this many pixels of the global search count as one.",
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
