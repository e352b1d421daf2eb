"""Settings of the front ends besides psi, and of how the errors of all of them are learnt."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class ScanMatchingConfig(BaseModel):
    """Settings that the front ends share which match scan after scan to a map of their own."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    voxel_size_m: float = Field(
        1.0, gt=0.0, description="Side of the voxels of its map [m]. Values of 0.5 to 2.0 measure alike on radar returns."
    )
    max_range_m: float = Field(100.0, gt=0.0, description="Farther returns are dropped [m].")


class KissIcpConfig(ScanMatchingConfig):
    """Settings of the KISS-ICP front end."""

    deskew: bool = Field(True, description="Whether each return is moved by the last motion to the end of its scan.")
    config_file: Path | None = Field(
        None,
        description="YAML file of KISS-ICP's own settings, which takes the place of voxel_size_m, max_range_m and "
        "deskew; null takes those.",
    )


class Open3dIcpConfig(ScanMatchingConfig):
    """Settings of the Open3D ICP front end."""

    method: Literal["point_to_point", "generalized"] = Field(
        "point_to_point",
        description="Open3D's registration to use; generalized takes three times as long and drifts no less.",
    )


class OdometryConfig(BaseModel):
    """Settings of the odometry front end: the errors of an odometry that does not state its own."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sigma_travel: float = Field(
        0.05,
        ge=0.0,
        description="Standard deviation of travel, as a share of it. The graph estimates it better where it can.",
    )
    sigma_yaw_rate: float = Field(0.02, gt=0.0, description="Standard deviation of the yaw rate [rad/s].")
