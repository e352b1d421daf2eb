"""Settings of the front ends besides psi."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class KissIcpConfig(BaseModel):
    """Settings of the KISS-ICP front end."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    voxel_size_m: float = Field(1.0, gt=0.0, description="voxel of its map [m]; 0.5 to 2.0 measure alike on radar returns")
    max_range_m: float = Field(100.0, gt=0.0, description="farther returns are dropped [m]")
    deskew: bool = Field(True, description="whether each return is moved by the last motion")
    config_file: Path | None = Field(
        None, description="YAML file of KISS-ICP's own, which takes the place of the settings above; null for those"
    )


class Open3dIcpConfig(BaseModel):
    """Settings of the Open3D ICP front end."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["point_to_point", "generalized"] = Field(
        "point_to_point", description="registration of Open3D's; generalized takes three times as long and drifts no less"
    )
    voxel_size_m: float = Field(1.0, gt=0.0, description="voxel of its map [m]; a scan's is half of it")
    max_range_m: float = Field(100.0, gt=0.0, description="farther returns are dropped [m]")
    reach_m: float = Field(1.0, gt=0.0, description="farthest correspondence [m], three times that for a first pass")
    keyframes: int = Field(20, ge=1, description="revolutions the map holds")
    keyframe_m: float = Field(2.0, ge=0.0, description="a revolution joins the map after this much travel [m]")
    keyframe_rad: float = Field(0.1, ge=0.0, description="or after this much turning [rad]")
