"""Settings of maps: how they are written, and how several become one."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class MapConfig(BaseModel):
    """Settings of the rendered map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell_m: float = Field(0.2, gt=0.0, description="Side of a cell of the nav2 map [m].")


class MergeConfig(BaseModel):
    """How several recordings become one map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    changes: bool = Field(True, description="Whether changes between the recordings are looked for.")
