"""`mqslam optimise` finds the optimum that GTSAM finds, of a run's graph and of others, and writes it where it is told."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from support.commands import mqslam, parse_strict_json

from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.formats.graphs.g2o import format_poses_and_edges, read_g2o
from mqslam.formats.tum import read_tum, write_tum

SIDES = 8


def square(pose: type) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns a way twice around a square whose steps are off, and its loop."""
    rng = np.random.default_rng(1)
    steps = np.tile([5.0, 0.0, np.pi / 2.0], (SIDES, 1))
    poses = se2.chain(steps + rng.normal(0.0, [0.2, 0.2, 0.05], steps.shape))
    is_planar = pose is gtsam.Pose2
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.2, 0.2, 0.05] if is_planar else [0.1, 0.1, 0.05, 0.2, 0.2, 0.3]))
    edges = [(k, k + 1, steps[k]) for k in range(SIDES)] + [(0, 4, np.zeros(3)), (4, 8, np.zeros(3))]
    for k, at in enumerate(poses):
        planar = gtsam.Pose2(*at)
        values.insert(k, planar if is_planar else gtsam.Pose3(planar).retract(rng.normal(0.0, 0.02, 6)))
    for a, b, step in edges:
        planar = gtsam.Pose2(*step)
        graph.push_back(
            gtsam.BetweenFactorPose2(a, b, planar, noise)
            if is_planar
            else gtsam.BetweenFactorPose3(a, b, gtsam.Pose3(planar), noise)
        )
    return graph, values


def optimum_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pose: type) -> gtsam.Values:
    """Returns the optimum with the first pose where it is, by another method than the command's."""
    held = gtsam.NonlinearFactorGraph()
    held.push_back(graph)
    is_planar = pose is gtsam.Pose2
    make = gtsam.PriorFactorPose2 if is_planar else gtsam.PriorFactorPose3
    first = values.atPose2(0) if is_planar else values.atPose3(0)
    held.push_back(make(0, first, gtsam.noiseModel.Isotropic.Sigma(3 if is_planar else 6, 1e-6)))
    return gtsam.GaussNewtonOptimizer(held, values).optimize()


@pytest.mark.parametrize("pose", [gtsam.Pose2, gtsam.Pose3])
def test_the_optimum_is_gtsams_and_is_written_with_the_edges_as_they_were(tmp_path: Path, pose: type) -> None:
    graph, values = square(pose)
    text = format_poses_and_edges(graph, values, range(SIDES + 1))
    (tmp_path / "graph.g2o").write_text(text)
    shown = mqslam("optimise", tmp_path / "graph.g2o", "--out", tmp_path / "optimised.g2o", "--json")
    assert shown.code == 0, shown.err
    facts, known = parse_strict_json(shown.out), optimum_of(graph, values, pose)
    assert (facts["poses"], facts["factors"], facts["left_out"]) == (SIDES + 1, SIDES + 2, 0)
    assert facts["dimensions"] == (2 if pose is gtsam.Pose2 else 3)
    assert facts["error_before"] == pytest.approx(graph.error(values), rel=1e-5)
    assert facts["error_after"] == pytest.approx(graph.error(known), rel=1e-5)
    assert facts["error_after"] < 0.5 * facts["error_before"]
    assert read_g2o(tmp_path / "optimised.g2o").values.equals(known, 1e-5)
    edges = [line for line in text.splitlines() if line.startswith("EDGE")]
    assert [line for line in (tmp_path / "optimised.g2o").read_text().splitlines() if line.startswith("EDGE")] == edges


def test_a_run_s_graph_is_written_as_a_trajectory_with_the_stamps_beside_it(tmp_path: Path) -> None:
    graph, values = square(gtsam.Pose2)
    (tmp_path / "graph.g2o").write_text(format_poses_and_edges(graph, values, range(SIDES + 1)))
    stamps = 1_600_000_000_000_000 + 250_000 * np.arange(SIDES - 1)  # what comes after them are submaps
    write_tum(tmp_path / "trajectory.tum", Trajectory(stamps, np.zeros((SIDES - 1, 3))))
    shown = mqslam("optimise", tmp_path / "graph.g2o", "--out", tmp_path / "optimised.tum")
    assert shown.code == 0 and "wrote" in shown.out and "error" in shown.out
    track, known = read_tum(tmp_path / "optimised.tum"), optimum_of(graph, values, gtsam.Pose2)
    np.testing.assert_array_equal(track.stamps_us, stamps)
    for k, pose in enumerate(track.poses):
        assert gtsam.Pose2(*pose).equals(known.atPose2(k), 1e-4)


def test_a_graph_that_gtsam_has_written_is_optimised_with_all_its_factors(tmp_path: Path) -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    graph.push_back(gtsam.PriorFactorPose2(X(0), gtsam.Pose2(3.0, 0.0, 0.0), noise))
    graph.push_back(gtsam.BetweenFactorPose2(X(0), X(1), gtsam.Pose2(1.0, 0.0, 0.0), noise))
    values.insert(X(0), gtsam.Pose2())
    values.insert(X(1), gtsam.Pose2())
    (tmp_path / "graph.txt").write_text(graph.serialize())
    (tmp_path / "values.txt").write_text(values.serialize())
    words = ("--values", tmp_path / "values.txt", "--out", tmp_path / "optimised.g2o")
    shown = mqslam("optimise", tmp_path / "graph.txt", *words)
    assert shown.code == 0, shown.err
    assert "2 poses in the plane, 2 factors\n" in shown.out and "without 1 factor that is no edge between poses" in shown.out
    lines = (tmp_path / "optimised.g2o").read_text().splitlines()
    np.testing.assert_allclose([float(line.split()[2]) for line in lines[:2]], [3.0, 4.0], atol=1e-6)
