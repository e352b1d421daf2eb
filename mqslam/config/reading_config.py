"""Settings of how recordings are understood: durations of turns, gaps, stamps that jitter, and flags of azimuths."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class ReadingConfig(BaseModel):
    """How a recording is understood where it does not say when its azimuths were measured, or which of them were."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    alike: float = expert(
        1.25, gt=1.0, description="Turns whose durations differ by less than this factor count as turns at the same rate."
    )
    fewest_azimuths: int = expert(
        8, ge=2, description="A polar scan of fewer azimuths does not tell how fast they were swept."
    )
    track_slack_s: float = expert(
        0.5,
        ge=0.0,
        description="A trajectory covers a recording if it lacks at most this much [s] of it at each end, where its first "
        "or last motion is continued.",
    )
    lidar_fov_deg: float | None = Field(
        None,
        gt=0.0,
        le=360.0,
        description="Angle [degrees] that the readings of a CARMEN log's FLASER lines sweep, centred ahead. null takes what "
        "the log's parameters state, else 180 degrees where there are 180, 181, 360 or 361 readings, as of SICK's lidars.",
    )

    @property
    def track_slack_us(self) -> int:
        """What a trajectory may lack of a recording at each end [us]."""
        return round(self.track_slack_s * 1e6)


USUAL_READING = ReadingConfig()
"""The settings where nobody states others."""
