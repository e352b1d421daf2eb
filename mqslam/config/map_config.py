"""Settings of the rendered map."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class MapConfig(BaseModel):
    """Settings of the rendered map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell_m: float = Field(0.2, gt=0.0, description="Side of a cell of the nav2 map [m].")
    travel_m: float = Field(
        0.1, ge=0.0, description="A scan is rendered once the sensor has moved this far since the last rendered one [m]."
    )
    travel_rad: float = Field(
        0.01, ge=0.0, description="A scan is rendered as well once the sensor has turned by this much [rad]."
    )
    keyframe_m: float = Field(
        2.5, gt=0.0, description="Path [m] between the scans that the result keeps, in which a recording is localised later."
    )
    well_seen: float = expert(
        99.0,
        ge=0.0,
        le=100.0,
        description="Percentile of the numbers of returns per cell that stands for a well-seen cell of the nav2 map. A cell "
        "counts as occupied from the square root of that number on, so that the threshold follows the speed of the drive.",
    )
    stop_s: float = expert(
        10.0, gt=0.0, description="Shortest stop that a warning names [s]; shorter ones are usual in traffic."
    )
