"""The relative motions that front ends measure, loop closures, and the results of the search for loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.core import se2
from mqslam.core.wording import count_of

_ROUNDING: Final = 1e-6  # smaller negative eigenvalues and asymmetries of a covariance, as shares of its trace, are rounding


class Status(StrEnum):
    """How far a measurement can be trusted.

    Attributes:
        CONVERGED: the motion is measured, and its covariance holds.
        DEGENERATE: a direction is not observed; the covariance is large along it.
        AMBIGUOUS: two motions explain the scan about equally well.
        LOST: too little of the scan fits the map; the motion is a prediction.
    """

    CONVERGED = "converged"
    DEGENERATE = "degenerate"
    AMBIGUOUS = "ambiguous"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Measurement:
    """The sensor's motion from t0 to t1.

    Args:
        t0: start of the motion [s] since the recording's start.
        t1: end of the motion [s] since the recording's start.
        pose: (3,) x [m], y [m], yaw [rad] of the pose at t1 in the frame of the pose at t0.
        covariance: (3, 3) covariance of `pose` in x, y, yaw [m, m, rad], in the frame of the pose at t0.
        status: how far the motion can be trusted.
        psi: the scan's score at its minimum; NaN where the front end has none.
        psi_odometry: the scan's score under the odometry's motion; NaN without odometry.
        points: number of returns used.
        matched: share of these returns that found a neighbour in the map; NaN where the front end does not state it.
        on_map: whether both scans were matched to one map, so that errors of successive motions cancel instead of adding
            up.
        apart: (3,) the motion measured backward in time minus the motion measured forward in time [m, m, rad]; half of it
            shows the error of `pose`, which is the mean of the two. Where `pose` is only one of the two, the difference is
            multiplied by the square root of two, so that this still holds. NaN where the motion was measured only once.

    Raises:
        ValueError: pose or covariance have other shapes, or numbers that are not finite, or the covariance is not symmetric
            or has a negative variance in some direction.
    """

    t0: float
    t1: float
    pose: NDArray[np.float64]
    covariance: NDArray[np.float64]
    status: Status = Status.CONVERGED
    psi: float = float("nan")
    psi_odometry: float = float("nan")
    points: int = 0
    matched: float = float("nan")
    on_map: bool = False
    apart: NDArray[np.float64] = field(default_factory=lambda: np.full(3, np.nan))

    def __post_init__(self) -> None:
        problem = _find_fault(self.pose, self.covariance)
        if problem:
            raise ValueError(f"the motion from {self.t0:.2f} s to {self.t1:.2f} s has {problem}")


def _find_fault(pose: object, covariance: object) -> str:
    """Returns what is wrong with a pose or its covariance, which a front end may give as anything; "" if they are right."""
    if not isinstance(pose, np.ndarray) or not isinstance(covariance, np.ndarray):
        return "a pose or a covariance that is no NumPy array"
    if pose.shape != (3,) or covariance.shape != (3, 3):
        shapes = f"a pose of shape {pose.shape} and a covariance of shape {covariance.shape}"
        return f"{shapes}, which must be (3,) and (3, 3)"
    if not (np.isfinite(pose).all() and np.isfinite(covariance).all()):
        return "a pose or a covariance that is not a number"
    rounding = _ROUNDING * abs(np.trace(covariance))
    if np.abs(covariance - covariance.T).max() > rounding:
        return "a covariance that is not symmetric"
    return "a covariance with negative variances" if np.linalg.eigvalsh(covariance)[0] < -rounding else ""


@dataclass(frozen=True, slots=True)
class Tie:
    """A measured pose of a scan or submap (a few scans rendered together) in the frame of an earlier scan or submap.

    Args:
        earlier, later: indices of the two scans in the recording, or of the two submaps among all submaps.
        pose: (3,) pose of the later scan or submap in the frame of the earlier [m, m, rad].
        covariance: (3, 3) covariance of `pose` in x, y, yaw [m, m, rad], in the frame of the earlier scan or submap.
    """

    earlier: int
    later: int
    pose: se2.Array
    covariance: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Loop(Tie):
    """A loop closure: the relative pose between two passes of one place.

    Args:
        matched: share of the later pass's returns that lie on returns of the earlier pass.
        psi: score per point of the two passes registered on each other.
    """

    matched: float
    psi: float


@dataclass(frozen=True, slots=True)
class Measured:
    """All motions measured in a recording, and the Doppler shift with which they were computed.

    Args:
        measurements: one motion per pair of successive scans.
        doppler_beta: range shift per closing speed [s].
        doppler_sigma: standard deviation of `doppler_beta` [s]; zero where it was not measured.
    """

    measurements: Sequence[Measurement]
    doppler_beta: float
    doppler_sigma: float = 0.0


@dataclass(frozen=True, slots=True)
class LoopSearch:
    """The result of a search for loop closures.

    Args:
        loops: the loop closures that were found, which enter the graph.
        tried: number of pairs of scans that were compared.
        ambiguous: number of compared pairs that match at several places, or at a place that free space contradicts.
        implausible: number of compared pairs that match only at a place that the trajectory rules out.
        unsure: number of further pairs that were not compared, because their relative pose is too uncertain for the
            search to cover.
        alike: number of submaps that the recognition of places looked up, and that fit several poses about equally well.
    """

    loops: list[Loop]
    tried: int
    ambiguous: int = 0
    implausible: int = 0
    unsure: int = 0
    alike: int = 0

    @property
    def warnings(self) -> list[str]:
        """Warnings for the user: one for each reason for which more pairs or submaps were left out than there are loops."""
        left_out = (
            (f"{count_of(self.ambiguous, 'pair')} of passes", self.ambiguous, "several places fit"),
            (count_of(self.alike, "submap"), self.alike, "several places fit"),
            (
                f"{count_of(self.implausible, 'pair')} of passes",
                self.implausible,
                "the only place that fits is ruled out by the trajectory",
            ),
            (
                f"{count_of(self.unsure, 'pair')} of passes",
                self.unsure,
                "the search for loops cannot cover the uncertainty of the trajectory",
            ),
        )
        return [
            f"loops: {what} {'was' if count == 1 else 'were'} left out, because {why}"
            for what, count, why in left_out
            if count > len(self.loops)
        ]


@dataclass(frozen=True, slots=True)
class Refined:
    """The result of the refinement of a trajectory.

    Args:
        loops: the loops that stay in the graph, because no tie measures the same passes.
        ties: registrations of single scans on earlier passes; in the graph, they replace all other loops.
        psi_before: psi per point of later passes' returns among earlier passes' returns, before optimisation; None where no
            place is passed twice.
        psi_loops: the same psi with the loops, before the refinement.
        psi_across: the same psi under the final trajectory.
        refused: whether the refinement was dropped, because its first round made this psi larger (worse) or unmeasurable.
    """

    loops: list[Loop]
    ties: list[Loop]
    psi_before: float | None = None
    psi_loops: float | None = None
    psi_across: float | None = None
    refused: bool = False
