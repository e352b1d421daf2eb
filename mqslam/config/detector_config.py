"""Settings of the detector."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator


class DetectorConfig(BaseModel):
    """Settings of the detector."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    threshold: float = Field(40.0, ge=0.0, le=255.0, description="smoothed power that is surely a target [0..255]")
    contrast: float = Field(
        7.0,
        gt=0.0,
        description="where noise is low, so many of its spreads above its median are enough: finer bins are smoothed more",
    )
    strongest: int = Field(12, ge=1, description="peaks kept per azimuth")
    smoothing_m: float = Field(0.2, ge=0.0, description="half width of the window that smooths power along range [m]")
    min_range_m: float = Field(2.5, ge=0.0, description="nearer returns are the vehicle itself [m]")
    max_range_m: float = Field(150.0, gt=0.0, description="farther returns are too blurred across the beam to help [m]")
    join_m: float = Field(0.6, ge=0.0, description="peaks of neighbouring azimuths this close in range are one target [m]")
    saturation: float = Field(
        12.0, gt=0.0, description="an azimuth whose median power exceeds the revolution's by this much is saturated [0..255]"
    )
    ring_share: float = Field(
        0.3,
        gt=0.0,
        le=1.0,
        description="a range at which this share of all azimuths peaks at once, and twice as many as around it, is a ring",
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self
