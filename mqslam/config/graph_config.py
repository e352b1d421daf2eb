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
    common_drift_m: float = expert(
        0.05,
        ge=0.0,
        description="Standard deviation [m] over 100 m of path of what the maps of both directions of time drift together, "
        "which their difference does not show. It grows with the root of the path. It is unknown; 0 to 0.09 was found in "
        "simulated cities.",
    )
    common_drift_rad: float = expert(
        0.0015,
        ge=0.0,
        description="The same of the yaw [rad], over 100 m of path; 0.0004 to 0.0024 was found in simulated cities.",
    )
    huber: float = Field(
        1.345, gt=0.0, description="Residual [standard deviations] beyond which the pull of an edge grows only linearly."
    )
    odometry_span_s: float = Field(
        10.0,
        gt=0.0,
        description="Longest span [s] over which odometry is compared with psi to find its noise, and the time between "
        "two values of its yaw rate's bias.",
    )
    odometry_fewest: int = expert(
        20,
        ge=2,
        description="With fewer motions than this that psi found itself, odometry is not calibrated, and as good as it "
        "states itself.",
    )
    prior_m: float = expert(
        1e-3, gt=0.0, description="Standard deviation [m] of the prior that holds the first pose at the origin."
    )
    prior_rad: float = expert(
        1e-4, gt=0.0, description="Standard deviation [rad] of the prior that holds the first yaw at zero."
    )
    lifted_m: float = expert(
        0.1,
        gt=0.0,
        description="Standard deviation [m] of z in a factor between poses in space, about which the radar says nothing: "
        "where a road bends, a vehicle leaves the plane in which it stands by no more within a submap. A run has planar "
        "poses and does without it.",
    )
    lifted_rad: float = expert(
        0.03,
        gt=0.0,
        description="The same of roll and pitch [rad]: roads bend, and springs give way, by about as much within a submap.",
    )
