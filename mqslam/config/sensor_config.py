"""Settings of the radar itself, and of the sensors beside it."""

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


class GyroscopeConfig(BaseModel):
    """How a gyroscope beside the radar is held against psi, and what makes it unfit."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    longest_delay_s: float = Field(
        3.0,
        gt=0.0,
        description="Largest error of the gyroscope's clock, late or early, that is looked for [s]. That of "
        "RADIATE's clock is 1.8 s.",
    )
    fewest: int = expert(
        40,
        ge=3,
        description="With fewer motions than this that psi found itself, a gyroscope is not calibrated, and not used.",
    )
    least_correlation: float = expert(
        0.5,
        gt=0.0,
        lt=1.0,
        description="A gyroscope whose turns correlate less with those of psi is not used. On a straight drive noise "
        "correlates with some axis at some delay, by far less than that.",
    )
    largest_scale: float = expert(
        1.25,
        gt=1.0,
        description="A gyroscope that turns more than this many times as far as the radar, or as little, is of another unit "
        "or broken, and is not used. The scale of smaller errors is put right.",
    )
    usual_delay_s: float = expert(
        0.3, gt=0.0, description="Error of the gyroscope's clock that needs no further evidence [s]."
    )
    far_correlation: float = expert(
        0.8,
        gt=0.0,
        lt=1.0,
        description="A gyroscope whose clock is farther off is not used unless its turns correlate this well with those of "
        "psi. Among many delays some fit by chance.",
    )
    most_wild: float = expert(
        0.1,
        gt=0.0,
        lt=1.0,
        description="Share of motions in which a calibrated gyroscope may contradict psi by more than three standard "
        "deviations. Psi itself is wrong in a few.",
    )
    told_sigmas: float = expert(
        5.0,
        gt=0.0,
        description="A delay, a scale or that both turn the same way is told by this many standard deviations.",
    )
    delay_tolerance_s: float = expert(
        0.01, ge=0.0, description="A smaller error of the clock is put right without a word [s]."
    )
    scale_tolerance: float = expert(
        0.01, ge=0.0, description="A smaller error of the scale is put right and not worth a word."
    )
    largest_scale_sigma: float = expert(
        0.005,
        gt=0.0,
        description="A gyroscope whose scale the radar does not tell to within this standard deviation is not used: a turn "
        "by a right angle would be off by half a degree.",
    )
    likely_scale: float = expert(
        0.03,
        ge=0.0,
        description="Error of the scale that data sheets of cheap gyroscopes allow: an audit blames nothing on a smaller "
        "one.",
    )
    knot_s: float = expert(1.0, gt=0.0, description="Time between two values of its bias in the graph [s].")
    first_walk: float = expert(
        0.001,
        gt=0.0,
        description="Standard deviation [rad/s] by which the bias may walk in a second, until the recording has shown "
        "how much it does.",
    )
    sigma_bias: float = expert(
        0.1, gt=0.0, description="Standard deviation of the bias when nothing is known of it [rad/s]."
    )
    sigma_scale: float = expert(0.1, gt=0.0, description="Standard deviation of an unknown scale.")


class GnssConfig(BaseModel):
    """How the fixes of a GNSS receiver are held against the trajectory, and what makes them unfit."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    longest_delay_s: float = Field(
        3.0, gt=0.0, description="Largest error of the receiver's clock, late or early, that is looked for [s]."
    )
    fewest: int = expert(10, ge=3, description="With fewer fixes than this within the recording they are not used.")
    reach: float = Field(
        3.0,
        gt=0.0,
        description="Distance from the trajectory beyond which a fix is a jump and hardly counts [standard deviations].",
    )
    most_jumps: float = expert(
        0.25,
        gt=0.0,
        lt=1.0,
        description="Share of the fixes that may be jumps. With more of them the fixes are not used: those that belong "
        "elsewhere, or are mirrored, agree with a part of a drive by chance, too.",
    )
    alike_s: float = expert(
        60.0,
        gt=0.0,
        description="Longest time over which fixes are averaged to learn how their errors wander [s]. Over a longer one the "
        "trajectory itself drifts as much.",
    )
    knot_s: float = expert(
        10.0,
        gt=0.0,
        description="Longest time between two values of a receiver's wandering error in the graph [s]. They stand closer "
        "where it soon wanders by more than the noise of a fix.",
    )
    largest_walk_m: float = expert(
        3.0,
        gt=0.0,
        description="Fixes that wander about the trajectory by more than this in a second are not used: no receiver's error "
        "does [m].",
    )
    largest_share: float = expert(
        0.05,
        gt=0.0,
        description="Fixes are not used if half of them lie farther from the trajectory than this share of its path: no "
        "trajectory drifts so much.",
    )
    antenna_apart: float = expert(
        3.0,
        gt=0.0,
        description="Where nothing says where the antenna sits, it is taken to be where the fixes of turning stretches show "
        "it, if that is farther from the radar than this many standard deviations, else at the radar.",
    )
    least_spread: float = expert(
        5.0,
        gt=0.0,
        description="Fixes are not used if the trajectory spreads over less than this many times the distance that half of "
        "them lie from it, since they would say nothing of its heading.",
    )


class VelocityConfig(BaseModel):
    """How velocities that chirps measure are held against psi, and what makes them unfit."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    fewest: int = expert(
        40,
        ge=3,
        description="With fewer motions than this that psi found itself, velocities are as good as they state themselves.",
    )
    largest_scale: float = expert(
        1.25,
        gt=1.0,
        description="Velocities that are this many times too large or too small have another Doppler shift, and are not "
        "used. Smaller errors of the scale are put right.",
    )
    most_wild: float = expert(
        0.1,
        gt=0.0,
        lt=1.0,
        description="Share of motions in which calibrated velocities may contradict psi by over three standard deviations.",
    )
    told_sigmas: float = expert(5.0, gt=0.0, description="A scale is told by this many standard deviations.")
    scale_tolerance: float = expert(0.01, ge=0.0, description="A smaller error of the scale is put right without a word.")
    span_s: float = expert(
        10.0, gt=0.0, description="Shortest stretch over which errors of the calibration are taken to be alike [s]."
    )
    sigma_scale: float = expert(
        0.05,
        gt=0.0,
        description="Standard deviation of the scale when nothing is known of it: the Doppler shift of a radar's chirps is "
        "known to a few percent.",
    )
    sigma_bias_mps: float = expert(
        0.1,
        gt=0.0,
        description="Standard deviation of a velocity's bias when nothing is known of it [m/s]; Boreas-RT's is as large.",
    )
