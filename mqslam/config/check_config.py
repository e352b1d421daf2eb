"""Settings of the check whether a recording contradicts what was assumed to read it."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from mqslam.config.fields import expert


class CheckConfig(BaseModel):
    """When a check calls a recording suspicious, and what it takes to tell."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    stretches: int = expert(3, ge=1, description="Number of stretches of the recording that are read.")
    stretch_scans: int = expert(12, ge=1, description="Number of polar scans in a stretch.")

    doubled: float = expert(
        0.5, gt=0.0, lt=1.0, description="A polar scan that begins within this share of a turn after another is doubled."
    )
    unsteady: float = expert(
        0.1, gt=0.0, description="Share of a turn by which the durations of nine tenths of all turns may differ."
    )
    span_share: float = expert(
        0.8,
        gt=0.0,
        le=1.0,
        description="Azimuth times that span less than this share of a turn do not say when each azimuth was measured.",
    )
    late_share: float = expert(
        0.05, ge=0.0, description="Share of a turn by which a polar scan may run on into the next one."
    )
    fewest_turns: int = expert(3, ge=1, description="Number of turns that it takes to tell whether turns are steady.")
    hole_steps: float = expert(
        3.0,
        gt=1.0,
        description="A step between azimuths of more than this many usual steps is a hole, and a turn may be incomplete by "
        "as much.",
    )
    unmeasured_share: float = expert(0.05, ge=0.0, lt=1.0, description="Largest share of azimuths marked as not measured.")

    fewest_steps: int = expert(
        5,
        ge=2,
        description="Least number of motions between scans for a comparison with odometry, or of the two orders of "
        "azimuths.",
    )
    keyframe_m: float = expert(
        40.0,
        gt=0.0,
        description="Travel [m] between keyframes while the order of azimuths is checked. A wrong order shows against what "
        "was seen from elsewhere, so that keyframes lie far apart.",
    )
    order_chance: float = expert(
        5e-3,
        gt=0.0,
        lt=1.0,
        description="psi's preference for one order of the azimuths counts if it would come about by chance with a "
        "smaller probability than this.",
    )
    order_gain: float = expert(
        0.02,
        ge=0.0,
        description="Least logarithm of the ratio of psi in the two orders that counts. Simulated drives too slow to tell "
        "the order show up to 0.010.",
    )
    mirrored: float = expert(
        4.0,
        gt=1.0,
        description="A direction of rotation is right if the mean squared yaw rate error of the other one is this "
        "many times as large.",
    )
    least_turn: float = expert(
        0.03, gt=0.0, description="Yaw rate [rad/s], root mean square, below which left and right cannot be told apart."
    )
    yaw_rate_floor: float = expert(0.004, gt=0.0, description="Least standard deviation of a measured yaw rate [rad/s].")
    explained: float = expert(
        0.9,
        gt=0.0,
        lt=1.0,
        description="Share of the variance of the radar's yaw rate that odometry must explain to tell a shift of stamps.",
    )
    largest_shift: float = expert(1.5, gt=0.5, description="Largest shift of stamps that is tried [turns].")
    shifts: int = expert(61, ge=3, description="Number of shifts of stamps that are tried, from earliest to latest.")
    shift_error: float = expert(
        0.25,
        gt=0.0,
        description="A shift of stamps is only judged if three standard deviations of it are at most this [turns].",
    )
    shift_ok: float = expert(0.5, gt=0.0, description="Smallest shift of stamps that is suspicious [turns].")
    least_speed: float = expert(1.0, gt=0.0, description="Speed [m/s] above which the length of a range bin shows.")
    wrong_scale: float = expert(
        0.05, gt=0.0, description="Relative difference between the radar's speed and odometry's that is suspicious."
    )
