"""Settings of the radar itself."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


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
        ge=-1.0,
        le=1.0,
        description="Range shift per closing speed [s], signed by the chirp, about 0.049 on the Oxford unit. Known radars "
        "are within 0.1 s: a value beyond 1 s is a mistake of the unit. Null measures it by psi.",
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

    doppler_stretches: int = expert(
        4, ge=1, description="Number of stretches of a recording on which psi measures the Doppler shift."
    )
    doppler_scans: int = expert(
        12, ge=3, description="Number of scans in a stretch on which psi measures the Doppler shift."
    )
    doppler_step: float = expert(
        0.05,
        gt=0.0,
        description="Step between the Doppler shifts that are tried [s]. The tried shifts include those of Navtech's "
        "radars.",
    )
    doppler_steps: int = expert(2, ge=1, description="Number of Doppler shifts that are tried to either side of zero.")
    doppler_gain: float = expert(
        0.003, ge=0.0, lt=1.0, description="Share of psi that a Doppler shift must save to be believed."
    )
    doppler_least: float = expert(
        0.01,
        ge=0.0,
        description="A smaller Doppler shift counts as none [s]: it moves returns by a tenth of their own error.",
    )
