"""Settings of odometry by psi."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, model_validator

from mqslam.config.fields import expert


class TrackerConfig(BaseModel):
    """Settings of odometry by psi over a running map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    keyframe_m: float = Field(
        4.0,
        gt=0.0,
        description="A scan joins the map after this much travel [m]. A map of few keyframes takes scans sooner.",
    )
    keyframes: int = Field(60, ge=1, description="Number of scans that the map holds.")
    sigma_omega: float = Field(
        0.03, gt=0.0, description="Change of yaw rate per 0.25 s that yaw acceleration does not explain [rad/s]."
    )
    sigma_alpha: float = Field(0.2, gt=0.0, description="Change of yaw acceleration per 0.25 s [rad/s^2].")
    speed_min: float = Field(-5.0, description="Slowest speed that the cold start tries [m/s]; negative is backwards.")
    speed_max: float = Field(40.0, description="Fastest speed that the cold start tries [m/s].")
    sigma_scale: float = Field(
        0.01,
        ge=0.0,
        description="Standard deviation of a distance travelled across a gap, as a share of that distance. Published "
        "lengths of one radar's range bins differ by 1.4 %, and a Doppler shift that is ignored costs as much.",
    )

    stamp_sigma_s: float | None = Field(
        None,
        ge=0.0,
        description="Standard deviation of a scan's stamp [s]. null takes what the reader has found where scans are stamped "
        "as they arrive, and 0 where stamps are the radar's own.",
    )

    final_width: float = expert(
        1.2,
        ge=1.0,
        description="Factor on the estimator's final widths s and beta_s where a scan is matched to the running map, whose "
        "many keyframes scatter more than the scans of a window.",
    )
    start_omega: float = expert(
        0.08,
        gt=0.0,
        description="The same as sigma_omega, for the first scans of a track, whose turning is hardly known yet [rad/s].",
    )
    start_alpha: float = expert(
        0.6,
        gt=0.0,
        description="The same as sigma_alpha, for the first scans of a track [rad/s^2]. It is also the standard deviation "
        "of a yaw acceleration of which nothing is known.",
    )
    matching_steps: int = expert(
        24,
        ge=1,
        description="Largest number of Newton steps when a scan is matched; with a good prediction a few are enough.",
    )
    settled: float = expert(
        0.05,
        ge=0.0,
        description="The search ends with a step shorter than this many standard deviations, which psi's curvature states.",
    )
    first_step: int = expert(
        1,
        ge=0,
        description="First step of the annealing at which the match of a predicted scan begins. A prediction is nearer to "
        "the match than the start of a search is, and the widest scale pulls scans back to where the map is denser.",
    )
    foresight_margin: float = expert(
        1.0,
        gt=0.0,
        description="Least beta_s at which a match begins, in units of the error that is expected of its prediction.",
    )
    fewest_returns: int = expert(
        40, ge=1, description="Fewest returns of a scan that is matched: five for each of the eight numbers of its state."
    )
    least_sector: float = expert(
        0.2,
        ge=0.0,
        description="Least sector that the directions of a scan's returns span [rad]. A single direction shows one "
        "pattern of ranges and no motion across it.",
    )
    doubtful_psi: float = expert(
        1.15,
        ge=0.0,
        description="A match whose psi per return is this many times the usual one or more may be at a wrong minimum: "
        "better ones are looked for ahead of it, behind it, and turned to either side.",
    )
    start_scans: int = expert(3, ge=2, description="Number of scans from which a track finds its first motion.")

    patience: int = expert(
        8, ge=1, description="Number of lost scans in a row after which the map is given up and a new one is tried."
    )

    segment_scans: int = Field(
        0,
        ge=0,
        description="Number of scans of a segment: segments are tracked on their own, so that several workers can do so at "
        "a time. 300 is a good one for long recordings. With 0 a recording is one segment. Of two drives of a thousand "
        "scans, one drifted by 3 % less in segments and one by 30 % more, in a bend in which either track errs.",
    )
    warm_up_scans: int = expert(
        36,
        ge=2,
        description="Number of scans before a segment that its track begins with, so that its own scans meet a map that has "
        "grown. Where there are not as many in a row that hold enough returns, no segment begins.",
    )
    shared_scans: int = expert(
        16,
        ge=0,
        description="Number of the last of these scans over which the motions pass from the track of one segment to that of "
        "the next.",
    )

    @model_validator(mode="after")
    def _check_speeds(self) -> TrackerConfig:
        if self.speed_max <= self.speed_min:
            raise ValueError(f"speed_max ({self.speed_max}) must be larger than speed_min ({self.speed_min})")
        return self

    @model_validator(mode="after")
    def _check_segments(self) -> TrackerConfig:
        warm_up = self.warm_up_scans
        if self.shared_scans > warm_up:
            raise ValueError(f"shared_scans ({self.shared_scans}) must not be larger than warm_up_scans ({warm_up})")
        if 0 < self.segment_scans < 2 * warm_up:
            raise ValueError(f"segment_scans ({self.segment_scans}) must be at least twice warm_up_scans ({warm_up})")
        return self

    @model_validator(mode="after")
    def _check_patience(self) -> TrackerConfig:
        if self.patience < self.start_scans:
            raise ValueError(f"patience ({self.patience}) must be at least start_scans ({self.start_scans})")
        return self
