"""Drives with the graph of their motions, as sure of them as asked, and a street that repeats."""

from __future__ import annotations

from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from mqslam.backend.loops.chain import Chain, Relative, SubmapLayout
from mqslam.backend.loops.closing import Candidate
from mqslam.backend.loops.passes import TrackedRun
from mqslam.backend.pose_graph import build_pose_graph
from mqslam.core import se2
from mqslam.core.scans import Returns, Scan

SURE = (0.01, 0.01, 1e-4)


def chain_of(drive: TrackedRun, sigmas: tuple[float, float, float] = SURE, between_passes: float | None = None) -> Chain:
    """Returns a drive with the graph of its motions.

    Args:
        drive: the drive.
        sigmas: standard deviations of the motion between two scans [m, m, rad].
        between_passes: standard deviation [m] of the motion between scans that are more than half a minute apart; its yaw
            is known a hundred times as well [rad].
    """
    poses, factors = drive.poses, []
    for k, (a, b) in enumerate(pairwise(poses)):
        late = between_passes is not None and drive.times[k + 1] - drive.times[k] > 30.0
        known = np.array([1.0, 1.0, 0.01]) * (between_passes or 0.0) if late else np.array(sigmas)
        noise = gtsam.noiseModel.Diagonal.Sigmas(known)
        factors.append(gtsam.BetweenFactorPose2(X(k), X(k + 1), gtsam.Pose2(*se2.between(a, b)), noise))
    graph = build_pose_graph(poses, factors)
    return Chain(drive, graph, graph.initial)


def candidate_of(drive: TrackedRun, pair: tuple[int, int], sigma_m: float) -> Candidate:
    """Returns a pair of scans as a candidate, of whose relative position the trajectory is as sure as asked."""
    covariance, rigid = np.diag([sigma_m**2, sigma_m**2, (0.01 * sigma_m) ** 2]), np.zeros((3, 3))
    chain = Relative(se2.between(drive.poses[pair[0]], drive.poses[pair[1]]), covariance)
    return Candidate(*pair, 15.0, 0.03, chain, SubmapLayout(rigid, rigid))


def fenced_street(period_m: float, seed: int) -> TrackedRun:
    """Returns a drive of 60 m along a street whose posts repeat; the sensor sees 40 m far."""
    rng = np.random.default_rng(7)
    count = int(1.5 * period_m)
    sides = rng.choice([-1, 1], count) * rng.uniform(5.0, 13.0, count)
    cell = np.column_stack([rng.uniform(0.0, period_m, count), sides])
    posts = np.concatenate([cell + np.array([k * period_m, 0.0]) for k in range(-int(60 / period_m), int(140 / period_m))])
    noise, scans, poses = np.random.default_rng(seed), [], []
    for k, x in enumerate(np.arange(0.0, 60.0, 2.0)):
        near = posts[np.hypot(posts[:, 0] - x, posts[:, 1]) < 40.0] - [x, 0.0]
        near = near + noise.normal(0.0, 0.05, near.shape)
        times = np.full(len(near), 0.25 * k)
        returns = Returns(np.hypot(*near.T), np.arctan2(near[:, 1], near[:, 0]), times, np.ones(len(near)))
        scans.append(Scan(0.25 * k, 0.25 * (k + 1), returns))
        poses.append((x, 0.0, 0.0))
    return TrackedRun.of(scans, np.array(poses))
