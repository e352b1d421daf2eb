"""Settings of loop closures and of the refinement after them, and how an audit, too, compares two passes of a place."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert

SpacingM = Annotated[
    float, Field(gt=0.0, description="Path [m] between the scans for which an earlier pass of the same place is looked for.")
]
SearchM = Annotated[float, Field(gt=0.0, description="Least half width of the search for the later pass's position [m].")]
SearchRad = Annotated[float, Field(gt=0.0, description="Least half width of the search in yaw [rad].")]


class PassConfig(BaseModel):
    """How two passes of one place are found and laid on each other."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    spacing_m: SpacingM = 5.0
    least_path_m: float = Field(
        60.0, gt=0.0, description="Two scans with less path between them [m] are not two passes: odometry ties them already."
    )
    reach_m: float = Field(12.0, gt=0.0, description="Distance [m] at which two passes still see the same things.")
    search_m: SearchM = 3.0
    search_rad: SearchRad = 0.03
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
    rival: float = Field(
        1.1, ge=1.0, description="The next best pose must score worse than the best one by at least this factor."
    )


class LoopConfig(PassConfig):
    """Settings of loop closures."""

    enabled: bool = Field(True, description="Whether loops are looked for.")
    rounds: int = Field(
        2,
        ge=1,
        description="Number of searches; each starts from the trajectory that the loops found before have corrected.",
    )
    # wider than most trajectories need: a street that repeats shows it within that distance, whatever the trajectory says
    search_m: SearchM = 15.0
    passes: int = Field(1, ge=1, description="Number of earlier passes, the nearest first, that a scan is tied to.")
    sigmas: float = Field(
        3.0,
        gt=0.0,
        description="The search reaches as far as so many standard deviations of what the trajectory says about the pose "
        "of one pass relative to the other. Where that is beyond gate_m or gate_rad, the passes are not compared.",
    )
    probability: float = Field(
        0.999,
        gt=0.5,
        lt=1.0,
        description="Probability of the chi-square quantile that a loop must not exceed, against the trajectory between its "
        "ends and against neighbouring loops.",
    )
    sure_m: float = Field(0.3, gt=0.0, description="Largest standard deviation of a loop's position [m].")
    kept: float = Field(
        1.1,
        ge=1.0,
        description="A loop stays if psi of its two passes in the optimised map is at most this many times as large as with "
        "the passes laid on each other.",
    )
    floor_m: float = Field(
        0.05,
        gt=0.0,
        description="Standard deviation [m] added to a loop's own, because submaps bend, which their score does not show.",
    )
    floor_rad: float = Field(
        0.0015, gt=0.0, description="Standard deviation of yaw [rad] added to a loop's own, because submaps bend."
    )
    cauchy: float = Field(
        3.0, gt=0.0, description="Residual [standard deviations] from which on the pull of a loop becomes weaker."
    )


class RefinementConfig(BaseModel):
    """Settings of the refinement of a trajectory, once its loops are closed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rounds: int = Field(
        0,
        ge=0,
        description="Most rounds in which every scan is measured against the other passes around it; each starts from the "
        "trajectory that the round before has refined. 0 leaves the trajectory as the loops have made it: passes lie "
        "better on each other after two rounds, but the trajectory as a whole was not always nearer to the truth.",
    )
    reach_m: float = Field(25.0, gt=0.0, description="Distance [m] between the scans of two passes that are compared.")
    spacing_m: float = Field(2.0, gt=0.0, description="Path [m] between the scans of the pass that others are laid into.")
    sample_m: float = Field(
        20.0, gt=0.0, description="Path [m] between the scans at which psi across passes is measured for the summary."
    )
    aside_m: float = Field(
        0.5, gt=0.0, description="A scan that psi moves farther than this [m] from where its loops have put it is not used."
    )
    settled: float = expert(
        0.1,
        gt=0.0,
        description="No further round follows once no scan has moved, against the pass it lies in, by more than this many "
        "standard deviations.",
    )
