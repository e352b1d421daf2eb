"""Settings of an audit, of the verdict on a map, and of a comparison."""

from __future__ import annotations

from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert

# by definition: tests that share the rate of false alarms: steps, spans, three biases, two of the lever arm, the delay,
# shaking, and revisits
_SHARERS: Final = 10


class AuditConfig(BaseModel):
    """How a map is judged."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    # an audited trajectory, which anyone may have made, may drift more than our own does before loops are closed
    spacing_m: float = Field(
        10.0, gt=0.0, description="Path [m] between the scans for which an earlier pass of the same place is looked for."
    )
    least_path_m: float = Field(
        60.0, gt=0.0, description="Two scans with less path between them [m] are not two passes: odometry ties them already."
    )
    reach_m: float = Field(12.0, gt=0.0, description="Distance [m] at which two passes still see the same things.")
    search_m: float = Field(3.0, gt=0.0, description="Least half width of the search for the later pass's position [m].")
    search_rad: float = Field(0.05, gt=0.0, description="Least half width of the search in yaw [rad].")
    gate_m: float = Field(40.0, gt=0.0, description="Largest half width of the search for the later pass's position [m].")
    gate_rad: float = Field(0.3, gt=0.0, description="Largest half width of the search in yaw [rad].")
    submap_m: float = Field(
        15.0,
        gt=0.0,
        description="The submap of the earlier pass holds the returns within this path [m] to either side of a scan.",
    )
    fewest: int = Field(300, ge=1, description="A submap with fewer returns than this is not compared.")
    matched: float = Field(
        0.45, gt=0.0, lt=1.0, description="Least share of the later pass's returns that must lie on the earlier pass."
    )
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
    drift: float = Field(0.02, ge=0.0, description="Drift of the trajectory to reckon with, per length of path [m/m].")
    drift_rad: float = Field(1e-4, ge=0.0, description="Drift of the yaw to reckon with, per length of path [rad/m].")
    step_fewest: int = expert(20, ge=2, description="Fewest steps that show how far off a step without a jump usually is.")
    step_doubtful: float = expert(
        0.1,
        ge=0.0,
        le=1.0,
        description="Share of the steps, those that match worst, whose sides are looked for farther apart as well.",
    )
    span_every_m: float = expert(15.0, gt=0.0, description="Path [m] from one such pair of scans to the next.")
    scan_matched: float = expert(
        0.6,
        gt=0.0,
        le=1.0,
        description="Scans beside each other must match at least this share of what two passes must (audit.matched): single "
        "scans, each with noise of its own, share fewer points than maps of many scans do.",
    )
    step: float = expert(
        2e-3,
        gt=0.0,
        description="Movement of a window's ends, in units of estimator.beta_s, below which the search for its best map "
        "ends; no direction is taken to be known better than that.",
    )


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
    false_alarms: float = Field(
        0.01,
        gt=0.0,
        lt=0.5,
        description="Probability with which the tests of steps, spans, pooled corrections, shaking and revisits against "
        "what the trajectory claims to know together call a good map bad.",
    )
    turn_warn: float = Field(
        8.7e-6, ge=0.0, description="A yaw that drifts by more than this is worth a look [rad/m]: 0.05 degrees in 100 m."
    )
    delay_warn: float = Field(
        0.01, ge=0.0, description="A trajectory whose stamps are late or early by more than this is worth a look [s]."
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
