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
    bend_m: float = Field(
        0.05, ge=0.0, description="A window whose best correction moves its points by less than this [m] is not torn."
    )
    jump_m: float = Field(0.1, ge=0.0, description="A step that moves the points after it by less than this [m] is no jump.")
    radius_m: float = Field(1.0, gt=0.0, description="Radius [m] of the neighbourhoods of the entropies and plane variance.")
    cell_m: float = Field(0.5, gt=0.0, description="Side of a cell of the evidence grid [m].")
    submap_spacing_m: float = Field(5.0, gt=0.0, description="Path [m] between the scans that a submap is rendered from.")
    torn_m: float = Field(0.5, gt=0.0, description="Two passes are torn if they are farther apart than this [m].")
    torn_rad: float = Field(
        0.02, gt=0.0, description="Two passes are torn, too, if one is turned against the other by more than this [rad]."
    )
    drift: float = Field(0.02, ge=0.0, description="Drift of the trajectory to reckon with, per length of path [m/m].")
    drift_rad: float = Field(1e-4, ge=0.0, description="Drift of the yaw to reckon with, per length of path [rad/m].")
    scan_matched: float = expert(
        0.6,
        gt=0.0,
        le=1.0,
        description="Scans beside each other must match at least this share of what two passes must (audit.matched): single "
        "scans, each with noise of its own, share fewer points than maps of many scans do.",
    )


class VerdictConfig(BaseModel):
    """How often a verdict may be wrong about a good map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    false_alarms: float = Field(
        0.01,
        gt=0.0,
        lt=0.5,
        description="Probability with which the tests of steps, spans, pooled corrections, shaking and revisits against "
        "what the trajectory claims to know together call a good map bad.",
    )

    @property
    def share_of_false_alarms(self) -> float:
        """Probability with which each of the tests that share the rate may call a good map bad."""
        return self.false_alarms / _SHARERS
