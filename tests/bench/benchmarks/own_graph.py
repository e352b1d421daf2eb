"""Processor time to optimise a graph of one's own with our factors, compared with one of GTSAM's between-factors alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import gtsam
import numpy as np
from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.timing import spend, time_in_turn
from gtsam.symbol_shorthand import M, X

from mqslam.backend.problem import Problem
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement
from mqslam.factors.between import CAUCHY, HUBER, lifted_between, loop_between

_SEED = 1
_POSES = 1000
_LAP = 200  # poses of a lap; every tenth one of a later lap is tied to the first
_SIGMAS = np.array([0.03, 0.02, 0.0008])  # of a scan in the map [m, m, rad]: what psi states in the simulated city
_PLACE_M = 0.5  # standard deviation of GNSS


def _measure(out: Path) -> list[Row]:
    reference = "GTSAM's between-factors alone, with the same losses"
    graphs = {
        reference: _native(robust=True),
        "the same without losses": _native(robust=False),
        "our factors, and GTSAM's of GNSS": _own(gtsam.Pose2),
        "ours in space": _own(gtsam.Pose3),
    }
    spent = time_in_turn({name: partial(spend, partial(_optimise, *graph)) for name, graph in graphs.items()}, 15)
    rows = []
    for name, (graph, values) in graphs.items():
        cells = {"variables": values.size(), "factors": graph.size()}
        cells |= {"ms": 1e3 * spent[name], "share": spent[name] / spent[reference]}
        rows.append(Row({"graph": name, **cells}, judged=name != reference))
    return rows


def _drive() -> tuple[list[Measurement], list[Loop]]:
    """Returns motions around a circle, five times, and loops, all with errors as large as they state."""
    rng = np.random.default_rng(_SEED)
    truth = se2.chain(np.tile([2.0, 0.0, 2.0 * np.pi / _LAP], (_POSES - 1, 1)))
    placed = truth + rng.normal(0.0, _SIGMAS, truth.shape)
    motions = []
    for k, motion in enumerate(se2.wrapped_between(placed[:-1], placed[1:])):
        motions.append(Measurement(0.25 * k, 0.25 * (k + 1), motion, 2.0 * np.diag(_SIGMAS**2), on_map=True))
    covariance = np.diag([0.03**2, 0.03**2, 0.001**2])
    loops = []
    for later in range(_LAP, _POSES, 10):
        earlier = later % _LAP
        pose = se2.wrapped_between(truth[earlier], truth[later]) + rng.normal(0.0, [0.03, 0.03, 0.001])
        loops.append(Loop(earlier, later, pose, covariance, 0.7, 0.5))
    return motions, loops


def _native(*, robust: bool) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns a graph with a between-factor for every motion and loop, with the losses of ours or without any."""
    motions, loops = _drive()
    graph, values, losses = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.mEstimator
    graph.addPriorPose2(X(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3))
    edges = [(k, k + 1, motion.pose, losses.Huber.Create(HUBER)) for k, motion in enumerate(motions)]
    edges += [(loop.earlier, loop.later, loop.pose, losses.Cauchy.Create(CAUCHY)) for loop in loops]
    gaussian = gtsam.noiseModel.Diagonal.Sigmas(np.sqrt(2.0) * _SIGMAS)
    for a, b, pose, loss in edges:
        noise = gtsam.noiseModel.Robust.Create(loss, gaussian) if robust else gaussian
        graph.add(gtsam.BetweenFactorPose2(X(a), X(b), gtsam.Pose2(*pose), noise))
    for k, pose in enumerate(se2.chain(motion.pose for motion in motions)):
        values.insert(X(k), gtsam.Pose2(*pose))
    return graph, values


def _own(pose: type) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns a graph with the factors that `psi_factors` and `loop_factors` make of the same drive, and with places."""
    motions, loops = _drive()
    problem = Problem(motions, [])
    factors = problem.make_factors(X, M)
    factors += [loop_between(X(loop.earlier), X(loop.later), loop) for loop in loops]
    chain, graph, values = se2.chain(motion.pose for motion in motions), gtsam.NonlinearFactorGraph(), gtsam.Values()
    is_planar = pose is gtsam.Pose2
    lift = (lambda factor: factor) if is_planar else lifted_between
    for factor in factors:
        graph.push_back(lift(factor))
    places = [
        *((X(k), at) for k, at in enumerate(chain)),
        *((M(j), chain[k]) for j, k in enumerate(problem.submaps.first_scans)),
    ]
    for key, at in places:
        values.insert(key, gtsam.Pose2(*at) if is_planar else gtsam.Pose3(gtsam.Pose2(*at)))
    add_prior, width = (graph.addPriorPose2, 3) if is_planar else (graph.addPriorPose3, 6)
    add_prior(X(0), pose(), gtsam.noiseModel.Isotropic.Sigma(width, 1e-3))
    make = gtsam.PoseTranslationPrior2D if is_planar else gtsam.GPSFactor
    noise = gtsam.noiseModel.Isotropic.Sigma(width // 3 + 1, _PLACE_M)
    for k in range(0, _POSES, 10):
        graph.add(make(X(k), chain[k, :2] if is_planar else np.array([*chain[k, :2], 0.0]), noise))
    return graph, values


def _optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
    gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()


BENCHMARKS = {
    "own_graph": Benchmark(
        what="Processor time to optimise 1,000 poses with GTSAM, called from Python, the median of 15 rounds.",
        data="simulated",
        seeds=(_SEED,),
        columns=(
            label("graph", "graph"),
            Column("variables", "variables", "{:.0f}"),
            Column("factors", "factors", "{:.0f}"),
            Column("ms", "processor time [ms]", "{:.1f}"),
            Column("share", "times the first", "{:.2f}", Goal.FAST),
        ),
        measure=_measure,
        bounds=(Bound("share", {"graph": "our factors, and GTSAM's of GNSS"}, most=2.0),),
    ),
}
