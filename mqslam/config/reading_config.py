"""Settings of how recordings are understood."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ReadingConfig(BaseModel):
    """How a recording is understood where it does not say so itself."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    lidar_fov_deg: float | None = Field(
        None,
        gt=0.0,
        le=360.0,
        description="Angle [degrees] that the readings of a CARMEN log's FLASER lines sweep, centred ahead. null takes what "
        "the log's parameters state, else 180 degrees where there are 180, 181, 360 or 361 readings, as of SICK's lidars.",
    )


USUAL_READING = ReadingConfig()
"""The settings where nobody states others."""
