"""Settings of what is taken from the power of polar scans: returns, and the sensor's velocity where chirps alternate."""

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
    most_returns: int = Field(
        1000,
        ge=1,
        description="Number of returns that are kept per scan, the strongest. All that stand out of the noise by "
        "`contrast` are kept, however many they are.",
    )
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

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self


class ChirpConfig(BaseModel):
    """How the sensor's velocity is measured where chirps go up and down in turn."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    doppler_beta: float = Field(
        0.0502,
        gt=0.0,
        le=1.0,
        description="Range shift per closing speed [s] of the chirps that go up, by which shifts become velocities. It is "
        "that of Boreas-RT's radar, the only one whose chirps are known to alternate.",
    )

    min_range_m: float = expert(
        2.5,
        ge=0.0,
        description="Nearer power is of the vehicle itself [m], which stands still in the sensor's frame.",
    )
    max_range_m: float = expert(150.0, gt=0.0, description="Farther power is left out [m], because noise outweighs it.")
    cell_m: float = expert(
        0.09,
        gt=0.0,
        description="Power is averaged over as many range bins as fit into this length [m]. It is shorter than an echo is "
        "wide, so that only computing time is lost.",
    )
    smoothing_m: float = expert(
        0.1,
        gt=0.0,
        description="Standard deviation of the Gaussian that smooths power along range [m]: half the width of an echo.",
    )
    contrast: float = expert(
        2.0,
        ge=0.0,
        description="Power counts as an echo from here on, above an azimuth's median and in units of the noise's spread "
        "(median minus 10th percentile).",
    )
    fastest_mps: float = expert(45.0, gt=0.0, description="Largest speed that is searched [m/s]: 160 km/h.")
    clear: float = expert(
        8.0,
        gt=0.0,
        description="The best velocity must fit the echoes better than the median of those tried by this many spreads of "
        "theirs (median absolute deviations as standard deviations). The best of thousands fits noise better by four.",
    )
    acceleration: float = expert(
        3.0,
        gt=0.0,
        description="Standard deviation of the acceleration during a turn along each axis [m/s^2]. A vehicle seldom brakes "
        "harder than this, and without acceleration 1 m/s^2 would turn the velocity of a quarter second by 0.02 m/s.",
    )
    sectors: int = expert(
        20,
        ge=4,
        description="Number of sectors of a turn that are left out in turn to find the covariance. They are wider than the "
        "beam, so that their errors are independent.",
    )
    fewest_azimuths: float = expert(
        0.1,
        gt=0.0,
        le=1.0,
        description="A scan measures no velocity if fewer of its azimuths than this share hold echoes.",
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> ChirpConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self
