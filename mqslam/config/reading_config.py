"""Settings of how recordings are understood: durations of turns, gaps, stamps that jitter, and flags of azimuths."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class ReadingConfig(BaseModel):
    """How a recording is understood where it does not say when its azimuths were measured, or which of them were."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    usual_turn_s: float = expert(
        0.25, gt=0.0, description="Duration of a turn [s] that is assumed where a recording shows none."
    )
    turns_around: int = expert(
        9,
        ge=1,
        description="Number of successive steps between polar scans whose median is the usual duration of a turn. Where a "
        "recording has fewer steps, each is judged by itself.",
    )
    alike: float = expert(
        1.25, gt=1.0, description="Turns whose durations differ by less than this factor count as turns at the same rate."
    )
    longest_step: float = expert(
        1.5,
        ge=1.0,
        description="A step of more usual turns than this from one polar scan to the next holds a gap, since at least half "
        "a turn is missing.",
    )
    short_share: float = expert(
        0.25,
        ge=0.0,
        le=1.0,
        description="Quantile of the steps between polar scans that counts as the duration of a turn in a recording "
        "of few polar scans. It is low, because polar scans may be missing but never come early.",
    )
    rate_cell: float = expert(
        1.1,
        gt=1.0,
        description="Steps are counted together to find turn rates if their durations differ by less than this factor.",
    )
    most_rates: int = expert(8, ge=1, description="Largest number of turn rates that a recording is assumed to have.")
    whole_turn: float = expert(
        0.2, gt=0.0, lt=0.5, description="A step counts as whole turns if it differs from them by at most this much [turns]."
    )
    cost_late: float = expert(
        1.5,
        gt=0.0,
        description="Cost of assuming that a polar scan came late, in units of the cost of assuming that one is missing.",
    )
    cost_early: float = expert(
        2.0,
        gt=0.0,
        description="Cost of assuming that a polar scan came early, in units of the cost of assuming that one is missing.",
    )
    cost_rate_change: float = expert(
        4.0,
        gt=0.0,
        description="Cost of assuming that the radar was told to turn at another rate, in units of the cost of assuming "
        "that a polar scan is missing.",
    )
    fewest_azimuths: int = expert(
        8, ge=2, description="A polar scan of fewer azimuths does not tell how fast they were swept."
    )
    compared_azimuths: int = expert(
        128,
        ge=8,
        description="Largest number of azimuths of a polar scan that are compared to find how fast they were swept.",
    )
    compared_apart: float = expert(
        0.25,
        gt=0.0,
        lt=1.0,
        description="Two azimuths are compared if they lie at least this share of their polar scan apart. Nearer ones would "
        "show the bursts in which a driver hands azimuths over.",
    )
    same_turn: float = expert(
        0.02,
        gt=0.0,
        description="A turn ends where its azimuths end if that differs by less than this share of a turn from what their "
        "rate says. Otherwise the rate decides, since the azimuths are not those of exactly one turn.",
    )
    least_jitter_s: float = expert(
        0.0001,
        gt=0.0,
        description="Jitter of arrival stamps below this [s] is left alone: at 30 m/s a vehicle drives 3 mm meanwhile.",
    )
    smoothest_ratio: float = expert(
        1e8,
        gt=0.0,
        description="Largest ratio that is tried between the variance of arrival jitter and the variance of changes "
        "of a turn's duration. With this ratio stamps are averaged over about a hundred turns.",
    )
    roughest_ratio: float = expert(
        1e-4,
        gt=0.0,
        description="Smallest ratio that is tried between the variance of arrival jitter and that of changes of a "
        "turn's duration; each further ratio is ten times as large.",
    )
    equal_likelihood: float = expert(
        0.01,
        gt=0.0,
        description="Ratios whose costs (twice the negative log-likelihood) differ by less than this count as equally "
        "likely, and the smallest is taken. Three polar scans cannot tell jitter from changes of the turn rate.",
    )
    most_turn_change: float = expert(
        0.1,
        gt=0.0,
        description="Share of its duration by which a turn can be faster or slower than the one before. A turning mass of "
        "some kilograms allows no more.",
    )
    stray_spreads: float = expert(
        5.0,
        gt=0.0,
        description="An arrival stamp further than this many spreads of the jitter from its place tells nothing.",
    )
    most_late_s: float = expert(
        3.0,
        gt=0.0,
        description="An arrival stamp that is later by more than this [s] than those around it allow is damaged, not late.",
    )
    scans_around_break: int = expert(
        8, ge=2, description="Number of polar scans on each side of a step that show whether the step is a lasting break."
    )
    break_spreads: float = expert(
        7.0, gt=0.0, description="A step further than this many spreads of the jitter from the usual one may be a break."
    )
    break_lasts: float = expert(
        0.6, gt=0.0, le=1.0, description="Share of an unusual step that must last behind it for the step to be a break."
    )
    fewest_rows: float = expert(
        0.1,
        ge=0.0,
        lt=1.0,
        description="An image with fewer azimuths than this share of the first image's is damaged, and is left out.",
    )
    validity_share: float = expert(
        0.75,
        gt=0.0,
        lt=1.0,
        description="Byte 10 of Oxford rows says whether an azimuth was measured if it is 255 in more than this share of "
        "the first image's rows, because few azimuths of a recording are not measured.",
    )
    chirp_share: float = expert(
        0.25,
        gt=0.0,
        lt=1.0,
        description="Otherwise byte 10 is the direction of the chirp, which alternates in Boreas-RT, if it is 255 in more "
        "than this share of the rows; in fewer it says nothing about single azimuths.",
    )
    track_slack_s: float = expert(
        0.5,
        ge=0.0,
        description="A trajectory covers a recording if it lacks at most this much [s] of it at each end, where its first "
        "or last motion is continued.",
    )
    lidar_fov_deg: float | None = Field(
        None,
        gt=0.0,
        le=360.0,
        description="Angle [degrees] that the readings of a CARMEN log's FLASER lines sweep, centred ahead. null takes what "
        "the log's parameters state, else 180 degrees where there are 180, 181, 360 or 361 readings, as of SICK's lidars.",
    )
    lidar_clip_share: float = expert(
        1e-3,
        ge=0.0,
        lt=1.0,
        description="A lidar log is clipped at its longest range if more than this share of its readings have that range.",
    )
    lidar_clip_count: int = expert(
        10,
        ge=0,
        description="Least number of readings at the longest range of a lidar log that is clipped there.",
    )
    lidar_clip_m: float = expert(3.0, gt=0.0, description="No lidar log is clipped at a range below this [m].")
    lidar_same_m: float = expert(
        0.01,
        gt=0.0,
        description="Poses in a lidar log that differ by less than this [m] count as equal: it is written to centimetres.",
    )
    lidar_same_rad: float = expert(
        0.01, gt=0.0, description="Headings in a lidar log that differ by less than this [rad] count as equal."
    )
    lidar_same_track_m: float = expert(
        0.05,
        gt=0.0,
        description="Poses beside the scans of a lidar log that stay within this [m] of its odometry are the odometry's "
        "own, and no SLAM has corrected them.",
    )
    lidar_same_track_rad: float = expert(
        0.02,
        gt=0.0,
        description="Headings beside the scans of a lidar log that stay within this [rad] of its odometry are the "
        "odometry's own.",
    )
    lidar_longest_sweep: float = expert(
        1.05,
        ge=1.0,
        description="Times of a lidar's beams are used if the sweep they claim is shorter than this many usual steps from "
        "scan to scan; a driver that claims more is wrong.",
    )

    @property
    def track_slack_us(self) -> int:
        """What a trajectory may lack of a recording at each end [us]."""
        return round(self.track_slack_s * 1e6)


USUAL_READING = ReadingConfig()
"""The settings where nobody states others."""
