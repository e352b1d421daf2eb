"""Settings of the radar itself."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class SensorConfig(BaseModel):
    """What a recording does not say about its radar."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_resolution_m: float | None = Field(
        None, gt=0.0, description="length of a range bin [m]; null takes the recording's or its format's"
    )
    doppler_beta: float | None = Field(
        None,
        ge=-1.0,
        le=1.0,
        description="range shift per closing speed [s], signed by the chirp, about 0.049 on the Oxford unit; known radars "
        "are within 0.1 s, so beyond 1 s it is a mistake of the unit; null measures it by psi",
    )
    clockwise: bool | None = Field(
        None,
        description="whether the radar turns clockwise, seen from above, where azimuths carry no angles; null takes the "
        "format's default, clockwise in all of them",
    )
    stamp: Literal["start", "end"] | None = Field(
        None,
        description="which instant of a revolution its only stamp is, where azimuths carry no stamps; null takes the "
        "format's default: end in mulran, radiate and images on a bag's /radar/polar (MulRan's player), start in other bags",
    )
