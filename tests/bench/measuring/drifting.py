"""Odometry that has lost its way by the first revisit, and the loops that a run closes in spite of it, against the truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from bench.benchmark import Cell
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import chi2

from mqslam.backend.loops.chain import as_relative
from mqslam.backend.loops.closing import find_loops
from mqslam.backend.problem import Problem
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.frontend import Context, measure_motions
from mqslam.core.scans import Scans
from mqslam.core.trajectory import Trajectory
from mqslam.execution.runner import Runner
from mqslam.mapping.keyframing import pick_spaced
from mqslam.psi.place import beam_of

NEAR_M, PATH_M, SPACING_M = 10.0, 60.0, 10.0
"""A revisit is a place so near to an earlier one, with so much path between them; places are so far apart [m]."""
FAR_M, FAR_RAD = 1.0, 0.03
"""A loop that is off by more than one of these is far off."""
CHANCE = 0.999
"""Probability of the chi-square quantile beyond which its own covariance does not explain how far off a loop is."""
_SCALE, _OFF_M = 0.05, 100.0  # how wrong the odometry is: as a share of the way, and at the first revisit
_NOISE_SHARE, _NOISE_RATE = 0.02, 0.01  # of each motion, and of its yaw rate [rad/s]
_STEPS_RATE = np.arange(0.0, 0.01, 1e-5)  # biases of the yaw rate that are tried [rad/s]


class Judged(NamedTuple):
    """Relative poses against the truth.

    Args:
        wrong: number of those that are far off, and farther than they state.
        far: number of those that are far off, whatever they state.
        worst_m, worst_rad: largest error; None of none.
        nees: mean of the squared errors in units of their covariances, which is 1 if these are right; None of none.
    """

    wrong: int
    far: int
    worst_m: float | None
    worst_rad: float | None
    nees: float | None


def find_revisits(truth: se2.Array) -> list[tuple[int, int]]:
    """Returns the nearest earlier scan and the scan of each place of a drive that shows an earlier place."""
    travelled, tree = se2.path_lengths(truth), cKDTree(truth[:, :2])
    pairs = []
    for k in pick_spaced(travelled, SPACING_M).tolist():
        near = [a for a in tree.query_ball_point(truth[k, :2], NEAR_M) if travelled[k] - travelled[a] > PATH_M]
        if near:
            pairs.append((min(near, key=lambda a, k=k: float(np.hypot(*(truth[a, :2] - truth[k, :2])))), k))
    return pairs


def judge_poses(earlier: se2.Array, later: se2.Array, poses: se2.Array, covariances: NDArray[np.float64]) -> Judged:
    """Compares poses (K, 3) of later scans in the frames of earlier ones with those of the true poses (K, 3) of both.

    Args:
        earlier, later: true poses.
        poses: relative poses.
        covariances: (K, 3, 3) of the relative poses.
    """
    if not len(poses):
        return Judged(0, 0, None, None, None)
    off = se2.wrapped_between(se2.between(earlier, later), poses)
    off_m, off_rad, squares = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2]), se2.normalise(off, covariances)
    far = (off_m > FAR_M) | (off_rad > FAR_RAD)
    wrong = far & (squares > chi2.ppf(CHANCE, 3))
    return Judged(int(wrong.sum()), int(far.sum()), float(off_m.max()), float(off_rad.max()), float(squares.mean()) / 3.0)


def lose_way(truth: se2.Array, times: NDArray[np.float64], seed: int) -> se2.Array:
    """Returns poses (N, 3) of odometry with a wrong scale and a yaw rate so wrong that the first revisit is 100 m off.

    Args:
        truth: (N, 3).
        times: (N,) [s].
        seed: of both signs and of the noise.
    """
    rng = np.random.default_rng(seed)
    longer, turning = rng.choice([-1.0, 1.0], 2)
    steps, spans = se2.wrapped_between(truth[:-1], truth[1:]), np.diff(times)
    noise = rng.standard_normal((len(steps), 2))
    a, b = find_revisits(truth)[0]

    def drive(bias: float) -> se2.Array:
        motions = steps.copy()
        motions[:, :2] *= 1.0 + _SCALE * longer + _NOISE_SHARE * noise[:, :1]
        motions[:, 2] += (turning * bias + _NOISE_RATE * noise[:, 1]) * spans
        return se2.chain(motions)

    def is_lost(bias: float) -> bool:
        poses = drive(bias)
        return bool(np.hypot(*(se2.between(poses[a], poses[b]) - se2.between(truth[a], truth[b]))[:2]) >= _OFF_M)

    low, high = 0, len(_STEPS_RATE) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if is_lost(_STEPS_RATE[middle]) else (middle, high)
    return drive(float(_STEPS_RATE[high]))


def measure_lost(
    scans: Scans, truth: se2.Array, seed: int, doppler_beta: float, revolution_s: float, runner: Runner
) -> dict[str, Cell]:
    """Closes the loops of a run by such odometry; returns cells about them.

    Args:
        scans: of the recording.
        truth: (N, 3) their true poses.
        seed: of the odometry.
        doppler_beta: range shift per closing speed [s].
        revolution_s: duration of a turn [s].
        runner: does the work.
    """
    config = Config()
    odometry = Trajectory(scans.stamps_us, lose_way(truth, scans.start_times, seed))
    context = Context(config, revolution_s, scans.start_us, odometry, doppler_beta=doppler_beta)
    problem = Problem(list(measure_motions("odometry", context, scans)), [])
    beam = beam_of(config.estimator, doppler_beta)
    search = find_loops(scans, problem, config.estimator, beam, runner)
    earlier, later = (
        np.array([getattr(loop, end) for loop in search.loops], dtype=np.int64) for end in ("earlier", "later")
    )
    poses = np.array([loop.pose for loop in search.loops]).reshape(-1, 3)
    covariances = np.array([as_relative(loop).covariance for loop in search.loops]).reshape(-1, 3, 3)
    judged, revisits = judge_poses(truth[earlier], truth[later], poses, covariances), find_revisits(truth)
    travelled = se2.path_lengths(truth)
    found = [np.abs(travelled[later] - travelled[k]).min(initial=np.inf) <= SPACING_M for _, k in revisits]
    after, (a, b) = problem.solve_poses(search.loops), revisits[0]
    off = se2.between(after[a], after[b]) - se2.between(truth[a], truth[b])
    return {
        "loops": len(search.loops),
        "wrong": judged.wrong,
        "far": judged.far,
        "worst_m": judged.worst_m,
        "worst_rad": judged.worst_rad,
        "nees": judged.nees,
        "found": float(np.mean(found)),
        "ambiguous": search.ambiguous,
        "off_m": float(np.hypot(off[0], off[1])),
    }
