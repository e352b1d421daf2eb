"""Settings of the pose graph."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class GraphConfig(BaseModel):
    """Settings of the pose graph."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    submap_m: float = Field(
        4.0,
        gt=0.0,
        description="Path [m] along which scans are taken to be matched to the same map. After it the map has taken a "
        "keyframe more, and is off by as much as a scan may be.",
    )
    huber: float = Field(
        1.345, gt=0.0, description="Residual [standard deviations] beyond which the pull of an edge grows only linearly."
    )
    odometry_span_s: float = Field(
        10.0, gt=0.0, description="Length of the spans [s] over which odometry is compared with psi to find its noise."
    )
    odometry_span_share: float = expert(
        0.5,
        gt=0.0,
        le=1.0,
        description="Share of a span's motions that psi must have found itself, so that the span shows how odometry errs.",
    )
    odometry_fewest_spans: int = expert(
        5,
        ge=1,
        description="With fewer spans than this, whose median may be small by chance, odometry is taken to be no better "
        "than it states.",
    )
    prior_m: float = expert(
        1e-3, gt=0.0, description="Standard deviation [m] of the prior that holds the first pose at the origin."
    )
    prior_rad: float = expert(
        1e-4, gt=0.0, description="Standard deviation [rad] of the prior that holds the first yaw at zero."
    )
