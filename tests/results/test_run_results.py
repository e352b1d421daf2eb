"""The covariances of a run as its file holds them, and what stands beside graph.g2o of each of its edges."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import gtsam
import numpy as np
from gtsam.symbol_shorthand import M, X

from mqslam.backend.marginals import PoseCovariances
from mqslam.backend.pose_graph import build_pose_graph
from mqslam.core.measurement import Loop
from mqslam.core.trajectory import Trajectory
from mqslam.factors.between import loop_between, psi_between
from mqslam.formats.covariances import read_covariances
from mqslam.formats.graphs.g2o import format_g2o
from mqslam.results.run_results import format_graph_table, write_marginals

POSE, COVARIANCE = np.array([1.0, 0.0, 0.0]), 1e-2 * np.eye(3)


def test_covariances_stand_in_the_frame_of_the_first_pose(tmp_path: Path) -> None:
    """The second pose heads to the left of the first one, so what is ahead of it lies along the first one's y axis."""
    stamps = np.array([1_547_131_046_353_776, 1_547_131_046_603_776])
    track = Trajectory(stamps, np.array([[5.0, 3.0, 1.0], [6.0, 4.0, 1.0 + np.pi / 2.0]]))
    own = np.array([[0.04, 0.0, 0.001], [0.0, 0.01, 0.0], [0.001, 0.0, 1e-4]])
    write_marginals(tmp_path / "c.csv", track, PoseCovariances(np.arange(2), np.stack([1e-6 * np.eye(3), own])))
    result = read_covariances(tmp_path / "c.csv")
    np.testing.assert_array_equal(result.stamps_us, stamps)
    np.testing.assert_allclose(result.covariances[0], 1e-6 * np.eye(3), atol=1e-18)
    np.testing.assert_allclose(result.covariances[1], [[0.01, 0, 0], [0, 0.04, 0.001], [0, 0.001, 1e-4]], atol=1e-12)


def test_covariances_that_are_not_known_leave_no_file(tmp_path: Path) -> None:
    track = Trajectory(np.array([0, 1]), np.zeros((2, 3)))
    write_marginals(tmp_path / "c.csv", track, PoseCovariances.unknown("the graph leaves a direction undetermined"))
    assert list(tmp_path.iterdir()) == []


def test_each_edge_has_a_row_that_says_what_it_is() -> None:
    loop = Loop(0, 2, POSE, COVARIANCE, 0.9, 0.5)
    plain = gtsam.BetweenFactorPose2(X(1), X(2), gtsam.Pose2(*POSE), gtsam.noiseModel.Isotropic.Sigma(3, 0.1))
    factors = [
        psi_between(M(0), X(1), POSE, COVARIANCE),
        psi_between(M(0), M(1), POSE, COVARIANCE),
        plain,
        loop_between(X(0), X(2), loop),
        psi_between(X(0), X(2), POSE, COVARIANCE),
    ]
    graph = build_pose_graph(np.zeros((3, 3)), factors, np.zeros((2, 3)))
    track = Trajectory(np.array([100, 200, 300]), np.zeros((3, 3)))
    run = cast(Any, SimpleNamespace(graph=graph, optimised=track))
    rows = list(csv.DictReader(io.StringIO(format_graph_table(run))))
    edges = [line.split() for line in format_g2o(graph.factors, graph.initial, 3).splitlines() if line.startswith("EDGE")]
    assert [(row["from"], row["to"]) for row in rows] == [(edge[1], edge[2]) for edge in edges]
    assert [row["kind"] for row in rows] == ["measurement", "map", "motion", "loop", "refinement"]
    assert [row["loss"] for row in rows] == ["huber", "huber", "none", "cauchy", "huber"]
    assert [row["parameter"] for row in rows] == ["1.345", "1.345", "", "3.0", "1.345"]
    assert [(row["from_stamp_us"], row["to_stamp_us"]) for row in rows[2:4]] == [("200", "300"), ("100", "300")]
    assert rows[0]["from_stamp_us"] == "" and rows[0]["to_stamp_us"] == "200"
