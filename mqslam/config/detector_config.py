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
    background_m: float = expert(
        0.5,
        gt=0.0,
        description="Standard deviation of the Gaussian whose average is taken off the power [m]. What is wider, such as "
        "haze behind strong targets, keeps its range whatever the speed is.",
    )
    contrast: float = expert(
        2.0,
        ge=0.0,
        description="Power counts as an echo from here on, above an azimuth's median and in units of the noise's spread "
        "(median minus 10th percentile).",
    )
    fastest_mps: float = expert(45.0, gt=0.0, description="Largest speed that is searched [m/s]: 160 km/h.")
    step_mps: float = expert(
        1.5,
        gt=0.0,
        description="Step between the velocities that are tried at first [m/s]. At 0.05 s it shifts echoes by 0.15 m, which "
        "is less than their width.",
    )
    clear: float = expert(
        8.0,
        gt=0.0,
        description="The best velocity must fit the echoes better than the median of those tried by this many spreads of "
        "theirs (median absolute deviations as standard deviations). The best of thousands fits noise better by four.",
    )
    window_mps: float = expert(
        2.5,
        gt=0.0,
        description="The shift of an azimuth is sought within this of what the best velocity so far says [m/s]. Traffic "
        "outside it does not disturb.",
    )
    outlier_spreads: float = expert(
        3.0,
        gt=0.0,
        description="Residual at which an azimuth's shift counts a quarter (Geman-McClure), in units of the residuals' "
        "spread in the scan. Traffic and chance peaks are beyond it.",
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
