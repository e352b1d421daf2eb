"""Settings of the check whether a recording contradicts what was assumed to read it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from mqslam.config.fields import expert


class CheckConfig(BaseModel):
    """When a check calls a recording suspicious, and what it takes to tell."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stretches: int = expert(3, ge=1, description="Number of stretches of the recording that are read.")
    stretch_scans: int = expert(12, ge=1, description="Number of polar scans in a stretch.")

    doubled: float = expert(
        0.5, gt=0.0, lt=1.0, description="A polar scan that begins within this share of a turn after another is doubled."
    )
    fewest_turns: int = expert(3, ge=1, description="Number of turns that it takes to tell whether turns are steady.")

    keyframe_m: float = expert(
        40.0,
        gt=0.0,
        description="Travel [m] between keyframes while the order of azimuths is checked. A wrong order shows against what "
        "was seen from elsewhere, so that keyframes lie far apart.",
    )
    mirrored: float = expert(
        4.0,
        gt=1.0,
        description="A direction of rotation is right if the mean squared yaw rate error of the other one is this "
        "many times as large.",
    )
    shifts: int = expert(61, ge=3, description="Number of shifts of stamps that are tried, from earliest to latest.")
    wrong_scale: float = expert(
        0.05, gt=0.0, description="Relative difference between the radar's speed and odometry's that is suspicious."
    )
