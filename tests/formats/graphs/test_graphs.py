"""Pose graphs in g2o's text form and in GTSAM's own."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V, X

from mqslam.errors import DataError
from mqslam.formats.graphs.g2o import format_poses_and_edges, read_edges, read_g2o, replace_poses
from mqslam.formats.graphs.gtsam_text import read_gtsam, recognises

PLANAR = """# a triangle
VERTEX_SE2 5 0 0 0
VERTEX_SE2 7 1 0 0.1
VERTEX_SE2 6 2 0.5 0.2
EDGE_SE2 5 7 1 0 0.1 10 1 0.5 20 0.2 30
EDGE_SE2 7 6 1 0.4 0.1 10 0 0 20 0 30
"""
SPATIAL = """VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 1 1 0 0.2 0 0 0.0998334166 0.9950041653
EDGE_SE3:QUAT 0 1 1 0 0.2 0 0 0.0998334166 0.9950041653 1 0 0 0 0 0.5 2 0 0 0 0 3 0 0 0 40 0 0 50 0 60
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "graph.g2o"
    path.write_text(text)
    return path


@pytest.mark.parametrize(("text", "edges"), [(PLANAR, 2), (SPATIAL, 1)])
def test_what_is_written_is_read_again(tmp_path: Path, text: str, edges: int) -> None:
    stored = read_g2o(write(tmp_path, text))
    again = format_poses_and_edges(stored.factors, stored.values, stored.keys)
    other = read_g2o(write(tmp_path, again))
    assert stored.factors.size() == other.factors.size() == edges
    for k in range(edges):
        one, two = stored.factors.at(k), other.factors.at(k)
        assert one.measured().equals(two.measured(), 1e-8)
        np.testing.assert_allclose(one.noiseModel().information(), two.noiseModel().information(), rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("text", [PLANAR.partition("\n")[2], SPATIAL])
def test_gtsams_reader_reads_the_same_where_it_reads_all(tmp_path: Path, text: str) -> None:
    path = write(tmp_path, text)
    stored, (factors, values) = read_g2o(path), gtsam.readG2o(str(path), text is SPATIAL)
    assert stored.factors.equals(factors, 1e-8) and stored.values.equals(values, 1e-8)


def test_an_information_matrix_has_the_place_first_in_the_file_and_the_rotation_first_in_gtsam(tmp_path: Path) -> None:
    information = read_g2o(write(tmp_path, SPATIAL)).factors.at(0).noiseModel().information()
    np.testing.assert_allclose(np.diag(information), [40, 50, 60, 1, 2, 3])
    assert information[3, 2] == pytest.approx(0.5)  # of x and the turn about z


def test_the_gaussian_under_a_loss_is_written(tmp_path: Path) -> None:
    stored = read_g2o(write(tmp_path, PLANAR))
    robust = gtsam.NonlinearFactorGraph()
    for k in range(stored.factors.size()):
        factor = stored.factors.at(k)
        huber = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.3), factor.noiseModel())
        robust.push_back(gtsam.BetweenFactorPose2(*factor.keys(), factor.measured(), huber))
    robust.push_back(gtsam.PriorFactorPose2(5, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1.0)))
    text = format_poses_and_edges(robust, stored.values, stored.keys)
    assert text == format_poses_and_edges(stored.factors, stored.values, stored.keys)


def test_poses_are_replaced_and_all_else_stays_as_it_was(tmp_path: Path) -> None:
    text = PLANAR + "FIX 6\n"
    path = write(tmp_path, text)
    stored = read_g2o(path)
    values = gtsam.Values(stored.values)
    values.update(7, gtsam.Pose2(123456.789012, -0.25, 3.0))
    replaced = replace_poses(path, values).splitlines()
    assert replaced[2] == "VERTEX_SE2 7 123456.789012 -0.25 3"
    assert [line for k, line in enumerate(replaced) if k != 2] == [
        line for k, line in enumerate(text.splitlines()) if k != 2
    ]


def test_the_vertices_of_fix_are_held_or_else_the_first_one(tmp_path: Path) -> None:
    assert read_g2o(write(tmp_path, PLANAR)).held == (5,)
    assert read_g2o(write(tmp_path, PLANAR + "FIX 7\nFIX 6\n")).held == (6, 7)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("VERTEX_XY 9 1 2", "line 7 is VERTEX_XY, which is not understood in a graph of VERTEX_SE2; give a graph of"),
        ("VERTEX_SE3:QUAT 9 0 0 0 0 0 0 0", "line 2 is VERTEX_SE2, which is not understood in a graph of VERTEX_SE3:QUAT"),
        ("VERTEX_SE2 5 1 1 1", "line 7 repeats the vertex 5; give every vertex once"),
        ("VERTEX_SE2 9 1e300 0 0", "line 7 is not VERTEX_SE2 with 1 vertices and 3 numbers; give"),
        ("VERTEX_SE2 9 nan 0 0", "line 7 is not VERTEX_SE2 with 1 vertices and 3 numbers; give"),
        ("VERTEX_SE2 -1 0 0 0", "line 7 is not VERTEX_SE2"),
        ("EDGE_SE2 5 6 1 0 0.1 10 1 0.5 20 0.2", "line 7 is not EDGE_SE2 with 2 vertices and 9 numbers; give"),
        ("EDGE_SE2 5 six 1 0 0.1 10 1 0.5 20 0.2 30", "line 7 is not EDGE_SE2"),
        ("EDGE_SE2 5 9 1 0 0.1 10 1 0.5 20 0.2 30", "line 7 joins the vertex 9, which is not there; give every vertex"),
        ("EDGE_SE2 5 5 1 0 0.1 10 1 0.5 20 0.2 30", "line 7 joins the vertex 5 with itself"),
        ("EDGE_SE2 5 6 1 0 0.1 -10 1 0.5 20 0.2 30", "line 7 has an information matrix that is not positive definite"),
        ("FIX", "line 7 is not FIX and vertices"),
        ("FIX 9", "fixes the vertex 9, which is not there"),
    ],
)
def test_a_line_that_cannot_be_meant_is_named(tmp_path: Path, line: str, message: str) -> None:
    path = write(tmp_path, PLANAR + line + "\n")
    with pytest.raises(DataError) as refused:
        read_g2o(path)
    assert str(refused.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds 0 poses and 0 edges, but a graph needs both; give a graph of VERTEX_SE2"),
        ("VERTEX_SE2 0 0 0 0\n", "holds 1 pose and 0 edges"),
    ],
)
def test_a_file_without_a_graph_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        read_g2o(write(tmp_path, text))


def test_pairs_are_read_without_the_graph(tmp_path: Path) -> None:
    assert read_edges(write(tmp_path, PLANAR)) == ([(5, 7), (7, 6)], 3)


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
    with pytest.raises(
        DataError,
        match=r"other\.txt: is not a gtsam\.Values in GTSAM's text form; give files with the texts that serialize\(\)",
    ):
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
    with pytest.raises(DataError, match=r"graph\.txt: has an error that is not finite; check the values, and the noise"):
        read_gtsam(*files)
