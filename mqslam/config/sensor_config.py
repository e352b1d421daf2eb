"""Settings of the radar itself, and of the sensors beside it."""

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
        ge=-1.0,
        le=1.0,
        description="Range shift per closing speed [s], signed by the chirp, about 0.049 on the Oxford unit. Known radars "
        "are within 0.1 s: a value beyond 1 s is a mistake of the unit. Null measures it by psi.",
    )
    clockwise: bool | None = Field(
        None,
        description="Whether the radar turns clockwise, seen from above. false mirrors what a radar sees that is mounted "
        "upside down. null takes what azimuths say, or clockwise where they carry no angles.",
    )
    stamp: Literal["start", "end"] | None = Field(
        None,
        description="Instant of a turn at which a polar scan is stamped. It matters only where azimuths carry no stamps. "
        "null takes the format's default: end in mulran, radiate and images on a bag's /radar/polar (MulRan's player) "
        "or /radar_data/b_scan_image (Navtech's driver), start in other bags.",
    )

    encoder_size: int | None = Field(
        None,
        ge=2,
        le=65536,
        description="Ticks of the encoder in a turn, where azimuths carry encoder values. null takes what the recording "
        "states, else what Navtech's radars have: 5600, or 16000 in messages of its driver that show it.",
    )
    radar_topic: str | None = Field(
        None, description="Topic of a bag's polar scans. null chooses it by type and name, or by the shape of its images."
    )
    odometry_topic: str | None = Field(None, description="Topic of a bag's odometry. null chooses it by type and name.")
    truth_topic: str | None = Field(None, description="Topic of a bag's ground truth. null chooses it by type and name.")
