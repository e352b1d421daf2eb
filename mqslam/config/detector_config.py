"""Settings of the detector."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator

from mqslam.config.fields import expert


class DetectorConfig(BaseModel):
    """Settings of the detector."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    threshold: float = Field(
        40.0, ge=0.0, le=255.0, description="Smoothed power above which a peak is a target in any data [0..255]."
    )
    contrast: float = Field(
        7.0,
        gt=0.0,
        description="Detection threshold in low-noise data, above the median power and in units of the noise spread "
        "(median minus 10th percentile). It applies where it is below `threshold`.",
    )
    strongest: int = Field(12, ge=1, description="Number of peaks that are kept per azimuth.")
    smoothing_m: float = Field(0.2, ge=0.0, description="Half width of the window that smooths power along range [m].")
    min_range_m: float = Field(2.5, ge=0.0, description="Nearer returns are of the vehicle itself and are dropped [m].")
    max_range_m: float = Field(
        150.0, gt=0.0, description="Farther returns are dropped [m]: they are too blurred across the beam to help."
    )
    join_m: float = Field(
        0.6, ge=0.0, description="Peaks of neighbouring azimuths that are this close in range are one target [m]."
    )
    saturation: float = Field(
        12.0,
        gt=0.0,
        description="An azimuth is saturated where its median power exceeds that of the polar scan by this much [0..255].",
    )
    ring_share: float = Field(
        0.3,
        gt=0.0,
        le=1.0,
        description="A range counts as a ring of the sensor itself if this share of all azimuths has a peak there, "
        "and ring_contrast times as many as at the ranges around it.",
    )

    join_bins: float = expert(
        1.5,
        ge=0.0,
        description="Least value of join_m in range bins. A peak's range is known to half a bin on either side, so "
        "neighbours of one target differ by up to a bin.",
    )
    ring_contrast: float = expert(
        2.0, ge=1.0, description="Factor by which more azimuths peak in a ring than at the ranges around it."
    )
    ring_cells: int = expert(
        9,
        ge=3,
        description="Number of range cells around a ring from which the usual share of peaking azimuths is taken, as "
        "their median.",
    )
    saturation_bins: int = expert(
        4,
        ge=1,
        description="Step between the range bins from which an azimuth's median power is taken; a larger step saves time.",
    )
    noise_azimuths: int = expert(
        8,
        ge=1,
        description="Step between the azimuths from which the spread of the noise is taken; a larger step saves time.",
    )

    fixed_range_m: float = expert(
        0.5,
        gt=0.0,
        description="Length of the polar cells in which returns that repeat in the sensor's own frame are counted [m].",
    )
    fixed_sectors: int = expert(
        180,
        ge=1,
        description="Number of cells around a turn in which returns that repeat in the sensor's own frame are counted.",
    )
    fixed_share: float = expert(
        0.7, gt=0.0, lt=1.0, description="A cell that returns in more than this share of all scans is part of the vehicle."
    )
    fixed_scans: int = expert(
        8, ge=2, description="Fewest scans that show which returns are the vehicle's own; with fewer, all are kept."
    )
    fixed_most: float = expert(
        0.2,
        gt=0.0,
        le=1.0,
        description="If more than this share of all returns repeats, the sensor stood still and they are returns of "
        "the world: none are dropped.",
    )
    most_unread: float = expert(
        0.5, gt=0.0, le=1.0, description="A recording of which more than this share cannot be read is refused."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self
