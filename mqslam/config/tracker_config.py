"""Settings of odometry by psi."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, field_validator

# Number of scans before a segment that its track begins with, so that its own scans meet a map that has grown. Where there
# are not as many in a row that hold enough returns, no segment begins.
WARM_UP_SCANS = 36


class TrackerConfig(BaseModel):
    """Settings of odometry by psi over a running map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sigma_omega: float = Field(
        0.03, gt=0.0, description="Change of yaw rate per 0.25 s that yaw acceleration does not explain [rad/s]."
    )
    sigma_alpha: float = Field(0.2, gt=0.0, description="Change of yaw acceleration per 0.25 s [rad/s^2].")
    speed_max: float = Field(40.0, gt=0.0, description="Fastest speed that the cold start tries [m/s].")

    stamp_sigma_s: float | None = Field(
        None,
        ge=0.0,
        description="Standard deviation of a scan's stamp [s]. null takes what the reader has found where scans are stamped "
        "as they arrive, and 0 where stamps are the radar's own.",
    )

    segment_scans: int = Field(
        0,
        ge=0,
        description="Number of scans of a segment: segments are tracked on their own, so that several workers can do so at "
        "a time. 300 is a good one for long recordings. With 0 a recording is one segment. Of two drives of a thousand "
        "scans, one drifted by 3 % less in segments and one by 30 % more, in a bend in which either track errs.",
    )

    @field_validator("segment_scans")
    @classmethod
    def _check_segments(cls, segment_scans: int) -> int:
        if 0 < segment_scans < 2 * WARM_UP_SCANS:
            raise ValueError(f"must be 0 or at least {2 * WARM_UP_SCANS}, twice the scans that a track warms up on")
        return segment_scans
