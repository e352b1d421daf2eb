"""Settings of the pose graph."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class GraphConfig(BaseModel):
    """Settings of the pose graph."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    floor_m: float = Field(0.01, gt=0.0, description="least standard deviation of an edge's position [m]")
    floor_rad: float = Field(0.0003, gt=0.0, description="least standard deviation of an edge's yaw [rad]")
    cancelling: float = Field(
        40.0,
        ge=1.0,
        description="both ends of an edge are matched to one map, so errors of successive edges cancel: in the graph an "
        "edge's covariance is divided by this, and the floor says how edges drift together",
    )
    huber: float = Field(1.345, gt=0.0, description="residual beyond which an edge's pull grows only linearly [sigma]")
    odometry_span_s: float = Field(
        10.0, gt=0.0, description="odometry noise is what it disagrees with psi over this span [s]"
    )
