"""Odometry that was made with the recording's gyroscope counts the turns of this gyroscope once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from support.bends import START_US, Unit, measured, read

from mqslam.backend.marginals import compute_all_marginals
from mqslam.backend.problem import Problem
from mqslam.backend.sensor_use import SensorUse, join_sensors
from mqslam.backend.sensors.odometry import make_odometry_edges, takes_turns_of
from mqslam.config import OdometryConfig
from mqslam.core.measurement import Measurement
from mqslam.core.sensors import Gyroscope, Sensors, Turning

SCANS, STATED = 800, OdometryConfig()
MOTIONS = measured(SCANS)
GYROSCOPE, OTHER = (read(Unit(), 200.0, seed=seed) for seed in (2, 3))


def make_odometry(gyroscope: Gyroscope) -> list[Measurement]:
    """Returns the motions of a wheel that rolls 2 m from scan to scan, and turns as a gyroscope does."""
    begins, ends = (np.array([getattr(m, name) for m in MOTIONS]) for name in ("t0", "t1"))
    turns = Turning.integrate(gyroscope, START_US, axis=2).between(begins, ends)
    covariance = np.diag([0.1, 0.1, 0.005]) ** 2
    return [
        replace(m, pose=np.array([2.0, 0.0, turn]), covariance=covariance) for m, turn in zip(MOTIONS, turns, strict=True)
    ]


def join(odometry: list[Measurement]) -> tuple[Problem, SensorUse]:
    edges = make_odometry_edges(odometry, MOTIONS, STATED)
    return join_sensors(Problem(MOTIONS, edges), odometry, Sensors(GYROSCOPE), None, START_US, STATED)


def covariances_of(problem: Problem) -> NDArray[np.float64]:
    graph, optimum = problem.optimise([])
    return compute_all_marginals(graph, optimum.values).covariances


def test_turns_that_odometry_shares_with_the_gyroscope_count_once() -> None:
    odometry = make_odometry(GYROSCOPE)
    shared, use = join(odometry)
    assert any("the odometry was made with this gyroscope" in note for note in use.notes)
    twice = replace(shared, odometry=make_odometry_edges(odometry, MOTIONS, STATED))
    once, counted_twice, alone = (covariances_of(p)[-1] for p in (shared, twice, replace(shared, odometry=[])))
    np.testing.assert_allclose(once[2, 2], alone[2, 2], rtol=0.01)
    assert counted_twice[2, 2] < 0.97 * alone[2, 2]
    for left, whole in zip(shared.odometry, twice.odometry, strict=True):  # the travel stays as it was
        np.testing.assert_array_equal(left.covariance[:2, :2], whole.covariance[:2, :2])
        np.testing.assert_array_equal(left.pose, whole.pose)
    assert once[0, 0] < 0.96 * alone[0, 0]


def test_odometry_with_a_gyroscope_of_its_own_keeps_its_turns() -> None:
    odometry = make_odometry(OTHER)
    problem, use = join(odometry)
    assert not any("was made with this gyroscope" in note for note in use.notes)
    assert max(edge.covariance[2, 2] for edge in problem.odometry) < 1.0
    assert takes_turns_of(OTHER, START_US, odometry) and not takes_turns_of(GYROSCOPE, START_US, odometry)
    assert not takes_turns_of(GYROSCOPE, START_US, [])
    assert not takes_turns_of(replace(OTHER, stamps_us=OTHER.stamps_us + 10**10), START_US, odometry)
