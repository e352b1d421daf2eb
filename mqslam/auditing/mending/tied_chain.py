"""Solves the pose graph that mends a trajectory, with the trajectory's steps, ties between nearby scans, and loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.stats import chi2

from mqslam.backend.loops.chain import Chain, as_relative, compute_chi_square, keep_consistent
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.pose_graph import build_pose_graph, optimise, poses_of
from mqslam.core import se2
from mqslam.core.measurement import Loop
from mqslam.factors.between import loop_between, psi_between

_ROUNDS: Final = 5  # numerical: most rounds in which loops correct the scale of the errors; fewer rounds settle the scale
_SETTLED: Final = 1.1  # numerical: a scale that grows by less than this factor has settled
_MEDIAN: Final = float(chi2.ppf(0.5, 3))  # by definition: median of the squared error of a loop in units of its covariance


class Tie(NamedTuple):
    """The measured pose of a scan in the frame of a scan shortly before it.

    Args:
        a, b: numbers of the earlier scan and of the later scan.
        pose: (3,) pose of scan b in the frame of scan a [m, m, rad].
        covariance: (3, 3) covariance of the pose, in the frame of scan a.
    """

    a: int
    b: int
    pose: se2.Array
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class TiedChain:
    """A pose graph of the steps of a trajectory and of ties between its scans, to which loops can be added.

    Args:
        steps: (N - 1, 3) motions from each scan to the next by the trajectory [m, m, rad].
        variances: (N - 1, 3) variances of the errors of the steps [m^2, m^2, rad^2], each in the frame of the earlier scan.
        ties: measured poses of scans in the frames of earlier scans.
        initial: (N, 3) poses x, y [m], yaw [rad] from which the optimisation starts; the first pose is held fixed.
        least_path_m: two loops within this path [m] of each other are neighbours and must agree.
    """

    steps: se2.Array
    variances: NDArray[np.float64]
    ties: Sequence[Tie]
    initial: se2.Array
    least_path_m: float

    def solve(self, loops: Sequence[Loop]) -> tuple[se2.Array, list[Loop]]:
        """Optimises the poses over steps, ties and those loops that agree with each other.

        Errors that grow slowly show only in loops. If the loops are farther off than the errors of steps and ties explain,
        the variances of all steps and ties are multiplied by the factor that explains the loops.

        Returns:
            The poses (N, 3) x, y [m], yaw [rad], and the loops that were used.

        Raises:
            EstimationError: the uncertainty of the poses cannot be computed.
        """
        chain = self._optimise([])
        if not loops:
            return chain.drive.poses, []
        wide, scale = self, 1.0
        for _ in range(_ROUNDS):
            kept = keep_consistent(loops, chain, self.least_path_m)
            if not kept:
                return chain.drive.poses, []
            known = chain.relate([(loop.earlier, loop.later) for loop in kept])
            off = [compute_chi_square(relative, as_relative(loop)) for relative, loop in zip(known, kept, strict=True)]
            growth = float(np.median(off)) / _MEDIAN
            if growth < _SETTLED:
                break
            scale *= growth
            wide = self._widen(scale)
            chain = wide._optimise([])
        return wide._optimise(kept).drive.poses, kept

    def _widen(self, factor: float) -> TiedChain:
        """Returns the chain with the variances of steps and ties multiplied by a factor."""
        ties = [tie._replace(covariance=tie.covariance * factor) for tie in self.ties]
        return replace(self, variances=self.variances * factor, ties=ties)

    def _optimise(self, loops: Sequence[Loop]) -> Chain:
        """Returns the poses, optimised over steps, ties and given loops, with the graph that gives their covariances."""
        factors = [
            psi_between(X(k), X(k + 1), step, np.diag(own))
            for k, (step, own) in enumerate(zip(self.steps, self.variances, strict=True))
        ]
        factors += [psi_between(X(tie.a), X(tie.b), tie.pose, tie.covariance) for tie in self.ties]
        factors += [loop_between(X(loop.earlier), X(loop.later), loop) for loop in loops]
        graph = build_pose_graph(self.initial, factors)
        values = optimise(graph).values
        poses = poses_of(values, graph.size)
        drive = TrackedRun((), np.arange(len(poses), dtype=np.float64), poses, se2.path_lengths(poses))
        return Chain(drive, graph, values)
