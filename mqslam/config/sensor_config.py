"""Settings of the radar itself."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class SensorConfig(BaseModel):
    """Properties of the radar that its recording does not state."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_resolution_m: float | None = Field(
        None,
        gt=0.0,
        description="Length of a range bin [m]. null takes what the recording states, else what is usual for its format.",
    )
    doppler_beta: float | None = Field(
        None,
        description="Range shift per closing speed [s], whose sign is that of the chirp; about 0.049 on Oxford's radar. "
        "null measures it by psi.",
    )
    clockwise: bool | None = Field(
        None,
        description="Whether the radar turns clockwise, seen from above. It matters only where azimuths carry no angles. "
        "null takes the format's default, which is clockwise in all of them.",
    )
    stamp: Literal["start", "end"] | None = Field(
        None,
        description="Instant of a turn at which a polar scan is stamped. It matters only where azimuths carry no stamps. "
        "null takes the format's default: end in mulran, radiate and images on a bag's /radar/polar (MulRan's player), "
        "start in other bags.",
    )
