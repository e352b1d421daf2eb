"""Settings of the rendered map."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class MapConfig(BaseModel):
    """Settings of the rendered map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell_m: float = Field(0.2, gt=0.0, description="cell of the nav2 map [m]")
    travel_m: float = Field(0.1, ge=0.0, description="a revolution nearer to the last rendered one adds nothing [m]")
    travel_rad: float = Field(0.01, ge=0.0, description="unless it has turned by more than this [rad]")
    stop_s: float = expert(
        10.0, gt=0.0, description="Shortest stop that a warning names [s]; shorter ones are usual in traffic."
    )
