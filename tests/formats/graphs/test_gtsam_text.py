"""Graphs that GTSAM has written itself are read with all their factors, and damaged ones end in an error and no more."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V, X

from mqslam.errors import DataError
from mqslam.formats.graphs.gtsam_text import read_gtsam, recognises


def graph_and_values() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Returns three poses in a row with robust edges, and a speed."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    huber = gtsam.noiseModel.mEstimator.Huber.Create(1.3)
    noise = gtsam.noiseModel.Robust.Create(huber, gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.2, 0.01])))
    for k in range(3):
        values.insert(X(k), gtsam.Pose2(1.1 * k, 0.0, 0.0))
        if k:
            graph.push_back(gtsam.BetweenFactorPose2(X(k - 1), X(k), gtsam.Pose2(1.0, 0.0, 0.0), noise))
    values.insert(V(0), np.array([1.0, 0.0, 0.0]))
    graph.push_back(gtsam.PriorFactorVector(V(0), np.array([2.0, 0.0, 0.0]), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    return graph, values


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """The two files of such a graph."""
    graph, values = graph_and_values()
    (tmp_path / "graph.txt").write_text(graph.serialize())
    (tmp_path / "values.txt").write_text(values.serialize())
    return tmp_path / "graph.txt", tmp_path / "values.txt"


def test_a_graph_is_read_with_all_its_factors_and_its_first_pose_held(files: tuple[Path, Path]) -> None:
    stored, (graph, values) = read_gtsam(*files), graph_and_values()
    assert stored.factors.equals(graph, 1e-12) and stored.values.equals(values, 1e-12)
    assert stored.keys == (X(0), X(1), X(2)) and stored.held == (X(0),)


def test_a_graph_whose_own_factors_hold_it_is_left_alone(files: tuple[Path, Path]) -> None:
    graph, _ = graph_and_values()
    graph.push_back(gtsam.PriorFactorPose2(X(1), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    files[0].write_text(graph.serialize())
    assert read_gtsam(*files).held == ()


def test_a_variable_without_a_value_is_named(files: tuple[Path, Path]) -> None:
    _, values = graph_and_values()
    values.erase(X(2))
    files[1].write_text(values.serialize())
    with pytest.raises(DataError, match=r"values\.txt: has no value for x2; give values for all variables"):
        read_gtsam(*files)


def test_a_file_of_another_kind_is_refused(files: tuple[Path, Path]) -> None:
    (other := files[0].with_name("other.txt")).write_text("VERTEX_SE2 0 0 0 0\n")
    assert recognises(files[0]) and not recognises(other) and not recognises(other.with_name("none"))
    with pytest.raises(DataError, match=r"other\.txt: is not a gtsam\.Values in GTSAM's text form; give what serialize\(\)"):
        read_gtsam(files[0], other)
    with pytest.raises(DataError, match=r"values\.txt: is not a readable gtsam\.NonlinearFactorGraph"):
        read_gtsam(files[1], files[0])


def test_a_damaged_file_is_refused_even_where_gtsam_ends_with_the_process(files: tuple[Path, Path]) -> None:
    text = files[0].read_text()
    files[0].write_text(text[: len(text) // 2])
    with pytest.raises(DataError, match=r"graph\.txt: is not a readable gtsam\.NonlinearFactorGraph"):
        read_gtsam(*files)


@pytest.mark.parametrize("x", [1e300, 1e200])
def test_values_without_a_finite_error_are_refused(files: tuple[Path, Path], x: float) -> None:
    _, values = graph_and_values()
    values.update(X(1), gtsam.Pose2(x, 0.0, 0.0))
    files[1].write_text(values.serialize())
    with pytest.raises(DataError, match=r"graph\.txt: has no finite error at the values; check the values, and the noise"):
        read_gtsam(*files)
