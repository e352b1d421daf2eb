"""Settings of an audit, of the verdict on a map, and of a comparison."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert
from mqslam.config.loop_config import PassConfig, SearchRad, SpacingM

# by definition: tests that share the rate of false alarms: steps, spans, three biases, two of the lever arm, the delay,
# shaking, and revisits
_SHARERS: Final = 10


class AuditConfig(PassConfig):
    """How a map is judged."""

    window: int = Field(6, ge=2, description="Number of scans in a window.")
    probability: float = Field(
        0.999,
        gt=0.5,
        lt=1.0,
        description="Probability of the chi-square quantile that the inflation of a torn window or revisit exceeds.",
    )
    bend_m: float = Field(
        0.05, ge=0.0, description="A window whose best correction moves its points by less than this [m] is not torn."
    )
    step_scans: int = Field(3, ge=1, description="Number of scans before a step that those after it are laid on.")
    jump_m: float = Field(0.1, ge=0.0, description="A step that moves the points after it by less than this [m] is no jump.")
    step_every: int = Field(2, ge=1, description="Every how many scans a step is judged.")
    span_m: float = Field(
        30.0,
        gt=0.0,
        description="Path [m] between scans that show what the whole map asks for together, such as a scale; less where "
        "half of what the sensor sees is nearer than this.",
    )
    radius_m: float = Field(1.0, gt=0.0, description="Radius [m] of the neighbourhoods of the entropies and plane variance.")
    cell_m: float = Field(0.5, gt=0.0, description="Side of a cell of the evidence grid [m].")
    submap_spacing_m: float = Field(5.0, gt=0.0, description="Path [m] between the scans that a submap is rendered from.")
    torn_m: float = Field(0.5, gt=0.0, description="Two passes are torn if they are farther apart than this [m].")
    torn_rad: float = Field(
        0.02, gt=0.0, description="Two passes are torn, too, if one is turned against the other by more than this [rad]."
    )
    claimed_m: float = Field(
        0.1,
        ge=0.0,
        description="Where the trajectory says how sure it is, two passes are torn if that and the measurement do not "
        "explain their offset, unless it moves the points by less than this [m]. torn_m and torn_rad do not count then.",
    )
    # an audited trajectory, which anyone may have made, may drift more than our own does before loops are closed
    spacing_m: SpacingM = 10.0
    drift: float = Field(0.02, ge=0.0, description="Drift of the trajectory to reckon with, per length of path [m/m].")
    drift_rad: float = Field(1e-4, ge=0.0, description="Drift of the yaw to reckon with, per length of path [rad/m].")
    search_rad: SearchRad = 0.05
    step_fewest: int = expert(20, ge=2, description="Fewest steps that show how far off a step without a jump usually is.")
    step_doubtful: float = expert(
        0.1,
        ge=0.0,
        le=1.0,
        description="Share of the steps, those that match worst, whose sides are looked for farther apart as well.",
    )
    rival_sigmas: float = expert(
        3.0,
        ge=0.0,
        description="A revisit is sure if the next best pose also scores worse by this many standard deviations of the "
        "difference of the two scores, so that one of several places that look alike is not best by chance.",
    )
    revisit_fewest: int = expert(
        10, ge=2, description="Fewest pairs of neighbouring revisits that show how far off a revisit usually is."
    )
    span_every_m: float = expert(15.0, gt=0.0, description="Path [m] from one such pair of scans to the next.")
    span_least_m: float = expert(
        15.0,
        gt=0.0,
        description="Such scans less than this apart [m] show no scale: laid on each other, they seem closer than they are "
        "by a few centimetres, whatever the path between them.",
    )
    span_fewest: int = expert(
        15, ge=1, description="Fewest such pairs that show a bias, or how far off such a pair usually is."
    )
    span_torn_m: float = Field(
        0.15,
        ge=0.0,
        description="A span is not torn if the scans at its ends are off each other by less than this [m], besides what all "
        "of the map asks for.",
    )
    lever_turn_rad: float = expert(
        0.3, gt=0.0, description="A span that turns by more than this [rad] shows where on the vehicle the sensor sits."
    )
    lever_turns: int = expert(3, ge=2, description="Fewest turns that show where on the vehicle the sensor sits.")
    sampled_windows: int = expert(
        100, ge=1, description="Number of windows, evenly spread, that a run judges of its own map; an audit judges all."
    )
    coverage_slack: float = expert(
        1.5,
        ge=0.0,
        description="A scan may begin before or end after the trajectory by this many turns and still counts as covered.",
    )
    few_stamps: int = expert(
        20, ge=1, description="A cloud with at least this many points per stamp is taken to have one stamp per scan."
    )
    cloud_sweep_s: float = expert(
        0.1, gt=0.0, description="Duration [s] that a sweep of a cloud is taken to have if every point has its own stamp."
    )
    narrow_start: float = expert(
        0.4,
        gt=0.0,
        le=1.0,
        description="The first search for a window's best map begins with this share of the annealing's widths, which finds "
        "all but large corrections.",
    )
    narrow_reach: float = expert(
        0.5,
        gt=0.0,
        description="A correction above this share of the first search's widest neighbourhood is searched for again "
        "with the annealing's full widths.",
    )
    speed_error_mps: float = expert(
        50.0,
        gt=0.0,
        description="Largest error of a trajectory's speed [m/s] that is looked for between two successive scans: more than "
        "any vehicle drives, so that a trajectory that stands still is found, too.",
    )
    speed_fewest: int = expert(
        40, ge=1, description="Two successive scans of which one has fewer points than this say nothing about the speed."
    )
    scan_matched: float = expert(
        0.6,
        gt=0.0,
        le=1.0,
        description="Scans beside each other must match at least this share of what two passes must (audit.matched): single "
        "scans, each with noise of its own, share fewer points than maps of many scans do.",
    )
    jump_mps2: float = expert(
        9.81,
        gt=0.0,
        description="A single step of a trajectory is a jump only if it takes a larger acceleration than this [m/s^2]: "
        "tyres give a vehicle about as much as gravity.",
    )
    jump_radps2: float = expert(
        10.0,
        gt=0.0,
        description="A single step of a trajectory is a jump in yaw only if it takes a larger angular acceleration than "
        "this [rad/s^2], which is beyond what a robot that turns on the spot reaches.",
    )
    jump_factor: float = expert(
        3.0,
        gt=1.0,
        description="A jump differs from the steps around it by this many times what the largest difference of the other "
        "steps is, so that noise of the poses is no jump.",
    )
    jump_quantile: float = expert(
        0.9,
        gt=0.5,
        lt=1.0,
        description="Jumps are looked for among steps above this quantile of the differences from the steps around them.",
    )
    least_overlap_kept: float = expert(
        0.8,
        gt=0.0,
        le=1.0,
        description="A best map that matches fewer points than this share of what the given map matches is searched for "
        "again with the annealing's full widths.",
    )
    step: float = expert(
        2e-3,
        gt=0.0,
        description="Movement of a window's ends, in units of estimator.beta_s, below which the search for its best map "
        "ends; no direction is taken to be known better than that.",
    )
    difference_step: float = expert(
        0.06,
        gt=0.0,
        description="Movement of a window's ends, in units of estimator.beta_s, over which the differences are taken that "
        "give the curvature of psi.",
    )
    unobserved: float = expert(
        100.0,
        gt=0.0,
        description="Standard deviation of a window's ends, in units of estimator.beta_s, along a direction that the window "
        "does not observe.",
    )
    fewest_neighbours: int = expert(
        5, ge=3, description="A neighbourhood of fewer points than this has no shape and does not count in the entropies."
    )
    hit_log_odds: float = expert(0.85, gt=0.0, description="Log odds that a return adds to its cell of the evidence grid.")
    miss_log_odds: float = expert(
        -0.4, lt=0.0, description="Log odds that a beam adds to each cell of the evidence grid that it passes through."
    )
    log_odds_limit: float = expert(3.5, gt=0.0, description="Largest absolute log odds of a cell of the evidence grid.")


class VerdictConfig(BaseModel):
    """When a map is called `warn` or `fail`, and how much evidence a verdict takes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    confidence: float = Field(
        0.95,
        gt=0.5,
        lt=1.0,
        description="Confidence of the exact binomial lower bound (Clopper and Pearson) of a share, which must exceed a "
        "limit before the share is called too large. At 0.95, at most one in twenty good maps is called bad by chance.",
    )
    power: float = Field(
        0.8,
        gt=0.5,
        lt=1.0,
        description="A map passes only if a map at the limit of `fail` would have shown more faults with this "
        "probability. If no window is torn, that takes 8 windows.",
    )
    windows_warn: float = Field(
        0.05, ge=0.0, lt=1.0, description="A map with a larger share of torn windows than this is worth a look."
    )
    windows_fail: float = Field(
        0.2, ge=0.0, lt=1.0, description="A map with a larger share of torn windows than this is useless."
    )
    revisits_warn: float = Field(
        0.02,
        ge=0.0,
        lt=1.0,
        description="A map with a larger share of torn revisits than this is worth a look; a few may be places that only "
        "look alike.",
    )
    revisits_fail: float = Field(
        0.1, ge=0.0, lt=1.0, description="A larger share of torn revisits than this shows that the whole map drifts."
    )
    false_alarms: float = Field(
        0.01,
        gt=0.0,
        lt=0.5,
        description="Probability with which the tests of steps, spans, pooled corrections, shaking and revisits against "
        "what the trajectory claims to know together call a good map bad.",
    )
    scale_warn: float = Field(
        0.002, ge=0.0, description="Distances or directions that are off by a larger share than this are worth a look [m/m]."
    )
    turn_warn: float = Field(
        8.7e-6, ge=0.0, description="A yaw that drifts by more than this is worth a look [rad/m]: 0.05 degrees in 100 m."
    )
    lever_warn: float = Field(
        0.05,
        ge=0.0,
        description="A sensor that sits farther from where the trajectory has it than this is worth a look [m].",
    )
    delay_warn: float = Field(
        0.01, ge=0.0, description="A trajectory whose stamps are late or early by more than this is worth a look [s]."
    )
    lost_fail: float = Field(
        0.2,
        ge=0.0,
        lt=1.0,
        description="With a larger share of lost scans than this the trajectory is mostly prediction. Any lost scan is "
        "worth a look.",
    )
    degenerate_warn: float = Field(
        0.1,
        ge=0.0,
        lt=1.0,
        description="A larger share than this of scans that do not observe every direction is worth a look.",
    )
    matched: float = Field(
        0.15,
        ge=0.0,
        lt=1.0,
        description="A window in which a smaller share of points than this is seen twice does not overlap, so that psi "
        "cannot judge it.",
    )
    part_warn: float = Field(
        0.1,
        ge=0.0,
        le=1.0,
        description="A trajectory without a pose for a larger share of scans than this covers only a part of the recording, "
        "which is worth a look: nothing is known of the rest. The first poses of a SLAM may be missing.",
    )
    uncovered_warn: float = Field(
        0.5,
        ge=0.0,
        le=1.0,
        description="A trajectory that covers no pose of a larger share of scans than this is worth a look: its stamps may "
        "not be the recording's.",
    )
    apart_fail: float = expert(
        0.5,
        ge=0.0,
        lt=1.0,
        description="With a larger share than this of windows that do not overlap, a map is useless as a whole.",
    )
    worse: float = Field(
        1.1,
        ge=1.0,
        description="Ratio of psi per point after optimisation to that before, above which optimisation made the map worse. "
        "Passes that loops lay on each other cost a little more than each pass alone.",
    )
    wrong_scale: float = Field(
        0.1,
        gt=0.0,
        description="A run whose speed differs from odometry's by a larger share, or the distances between GNSS fixes from "
        "those in the trajectory, has the wrong length of range bins, or odometry the wrong scale. Worn tyres and slip are "
        "a few percent.",
    )

    @property
    def share_of_false_alarms(self) -> float:
        """Probability with which each of the tests that share the rate may call a good map bad."""
        return self.false_alarms / _SHARERS


class MendConfig(BaseModel):
    """How a trajectory is mended by what its audit has found."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rounds: int = Field(
        5,
        ge=1,
        description="Most rounds of mending a trajectory and auditing it again. A further round follows only if the mended "
        "trajectory does not pass yet, but lays more revisits on each other than the one before or has fewer torn windows.",
    )


class CompareConfig(BaseModel):
    """What a comparison of front ends points out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    places: int = expert(6, ge=1, description="Number of places shown at which the trajectories differ most.")
    places_apart: int = expert(2, ge=0, description="Least number of windows between two such places.")
    lever_m: float = expert(
        20.0,
        gt=0.0,
        description="A difference in yaw counts as much as the distance by which it moves a point this far away [m].",
    )
