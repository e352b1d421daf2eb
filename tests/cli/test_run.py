"""One command takes a recording to its map: every file it leaves is whole and right."""

from __future__ import annotations

import csv
import html
import re
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from plyfile import PlyData
from support.commands import mqslam, parse_strict_json, read_contents, read_summary
from support.parameters import mostly_slow
from support.recordings import KINDS, bag_path, write_bag
from support.reported import assert_alone

from mqslam.config import Config, load_config, set_doppler_beta
from mqslam.core import se2
from mqslam.core.trajectory import Trajectory
from mqslam.execution import local_engine
from mqslam.formats.covariances import read_covariances
from mqslam.formats.recordings import open_recording
from mqslam.formats.tum import read_tum

NAMES = (
    "summary.json config.yaml run.log report.html measurements.csv covariances.csv graph.g2o graph.csv trajectory.tum "
    "ground_truth.tum odometry.tum map.ply map.pgm map.yaml keyframes"
)
FILES = set(NAMES.split())
PLACED = {"map.tif", "trajectory.geojson"}  # where GNSS places the map on the Earth
KEYS = {
    "mqslam_version": None,
    "dataset": {"format", "path", "revolutions", "duration_s", "length_m", "points"},
    "psi": {
        f"{what}{when}" for what in ("", "per_point_", "across_passes_", "matched_") for when in ("odometry", "optimised")
    },
    "verdict": {"status", "reasons"},
    "factors": {"odometry", "psi", "loop", "loop_rejected", "refinement"},
    "evaluation": {"ate_rmse_m", "drift_percent", "drift_deg_per_100m"},
    "runtime_s": {"read", "detect", "windows", "loops", "refine", "optimise", "render", "total"},
    "peak_rss_mb": None,
}
HEADER = "t0,t1,dx,dy,dyaw,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw,psi,psi_odometry,points,matched,status"
SCANS, ALONE = 48, ("--imu", "none", "--gnss", "none")


def rows_of(out: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((out / "measurements.csv").read_text().splitlines()))


def lines_of(out: Path, kind: str) -> list[list[str]]:
    return [line.split()[1:] for line in (out / "graph.g2o").read_text().splitlines() if line.startswith(kind)]


def error_m(estimate: Trajectory, truth: Trajectory) -> float:
    """Returns the RMS of the position [m] after the first poses have been laid on each other."""
    there = truth.at(estimate.stamps_us)
    apart = se2.between(estimate.poses[0], estimate.poses) - se2.between(there[0], there)
    return float(np.sqrt((apart[:, :2] ** 2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def run(street: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Runs the street by radar and odometry, with options, and says where the results are."""

    def command(*options: str | Path) -> Path:
        out = tmp_path_factory.mktemp("run") / "deep" / "out"
        result = mqslam("run", street, "--out", out, "--jobs", "1", *ALONE, *options)
        assert result.code == 0, result.err
        return out

    return command


@pytest.fixture(scope="module")
def result(run: Callable[..., Path]) -> Path:
    """The street with all defaults."""
    return run()


@pytest.fixture(scope="module")
def without_odometry(run: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The street without odometry and with a settings file, and that file."""
    settings = tmp_path_factory.mktemp("settings") / "mine.yaml"
    settings.write_text("sensor: {doppler_beta: 0.0}\nmap: {cell_m: 0.5}\ntracker: {sigma_alpha: 0.3}\n")
    return run("--odometry", "none", "--config", settings), settings


def test_a_run_leaves_every_file_and_nothing_beside_them(result: Path) -> None:
    assert {path.name for path in result.iterdir()} == FILES
    assert all(path.stat().st_size > 0 for path in result.iterdir())
    assert list(result.parent.iterdir()) == [result]


def test_the_summary_has_the_stable_keys(result: Path, street: Path) -> None:
    summary = read_summary(result)
    for key, inner in KEYS.items():
        assert key in summary
        if inner is not None:
            assert inner <= summary[key].keys(), key
    assert summary["dataset"]["format"] == "oxford" and summary["dataset"]["path"] == str(street)
    assert summary["dataset"]["revolutions"] == SCANS
    assert summary["dataset"]["duration_s"] == pytest.approx(12.0, abs=0.01)
    truth = read_tum(street / "gt" / "poses_tum.txt")
    assert summary["dataset"]["length_m"] == pytest.approx(truth.length_m, rel=0.02)
    assert summary["factors"] == {"odometry": SCANS - 1, "psi": SCANS - 1, "loop": 0, "loop_rejected": 0, "refinement": 0}
    assert summary["verdict"]["status"] == "pass" and summary["verdict"]["reasons"]
    assert summary["inflation"]["torn"] == summary["inflation"]["torn_share_at_least"] == 0
    assert 0.3 < summary["inflation"]["torn_share_at_most"] < 0.35  # of 8 windows
    assert summary["warnings"] == []
    runtime = summary["runtime_s"]
    assert 0.0 < sum(runtime.values()) - runtime["total"] <= runtime["total"] + 1e-6
    assert 20.0 < summary["peak_rss_mb"] < 20_000.0


def test_the_optimised_map_is_crisper_than_the_odometrys(result: Path) -> None:
    psi = read_summary(result)["psi"]
    assert psi["per_point_optimised"] < 0.8 * psi["per_point_odometry"]
    assert psi["matched_optimised"] > psi["matched_odometry"]


def test_the_optimised_trajectory_is_closer_to_truth_than_the_odometry(result: Path, street: Path) -> None:
    truth = read_tum(street / "gt" / "poses_tum.txt")
    before, after = (error_m(read_tum(result / f"{name}.tum"), truth) for name in ("odometry", "trajectory"))
    assert after < 0.3 * before and after < 0.5
    summary = read_summary(result)
    assert summary["evaluation"]["ate_rmse_m"] < 0.3 * summary["evaluation_odometry"]["ate_rmse_m"]


@pytest.mark.parametrize("name", ["trajectory", "odometry"])
def test_evo_reads_a_pose_per_scan(result: Path, street: Path, name: str) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    track = file_interface.read_tum_trajectory_file(str(result / f"{name}.tum"))
    assert track.check()[0]
    np.testing.assert_allclose(track.timestamps * 1e6, open_recording(street).stamps_us, rtol=0.0, atol=1.0)
    yaws = 2.0 * np.arctan2(track.orientations_quat_wxyz[:, 3], track.orientations_quat_wxyz[:, 0])
    ours = read_tum(result / f"{name}.tum")
    np.testing.assert_allclose(track.positions_xyz[:, :2], ours.poses[:, :2])
    np.testing.assert_allclose(se2.wrap(yaws - ours.poses[:, 2]), 0.0, atol=1e-8)


def test_measurements_have_a_row_per_pair_of_scans(result: Path) -> None:
    assert (result / "measurements.csv").read_text().splitlines()[0] == HEADER
    rows = rows_of(result)
    assert len(rows) == SCANS - 1
    assert float(rows[0]["t0"]) == 0.0
    assert all(a["t1"] == b["t0"] for a, b in pairwise(rows))
    for row in rows:
        upper = [float(row[name]) for name in HEADER.split(",")[5:11]]
        covariance = np.zeros((3, 3))
        covariance[np.triu_indices(3)] = upper
        assert np.linalg.eigvalsh(covariance, UPLO="U")[0] > 0.0
        assert float(row["psi"]) > 0.0 and float(row["psi_odometry"]) > 0.0
        assert int(row["points"]) > 100 and 0.3 < float(row["matched"]) <= 1.0
        assert row["status"] == "converged"


def test_covariances_have_a_row_per_scan_and_grow_with_the_way(result: Path) -> None:
    given, track = read_covariances(result / "covariances.csv"), read_tum(result / "trajectory.tum")
    np.testing.assert_array_equal(given.stamps_us, track.stamps_us)
    sigmas = np.sqrt(np.einsum("kii->ki", given.covariances))
    assert np.all(np.diff(sigmas[[0, 1, -1]], axis=0) > 0.0) and np.all(sigmas[-1] < [1.0, 1.0, 0.1])


def test_the_summary_says_how_sure_the_last_pose_is_along_and_across(result: Path) -> None:
    last = read_summary(result)["last_pose"]
    yaws = read_tum(result / "trajectory.tum").poses[:, 2]
    given = read_covariances(result / "covariances.csv").covariances[-1]
    turned = se2.rotate_covariance(given, yaws[0] - yaws[-1])
    sigmas = dict(zip(("sigma_along_m", "sigma_across_m", "sigma_yaw_rad"), np.sqrt(np.diag(turned)), strict=True))
    scale = read_summary(result)["range_scale"]
    by_scale = scale["sigma"] * np.hypot(*read_tum(result / "trajectory.tum").poses[-1, :2])
    share = by_scale**2 / np.sum(np.diag(turned)[:2])
    expected = {**sigmas, "prior_share": share}
    assert last == {name: pytest.approx(value, rel=1e-4) for name, value in expected.items()} and 0.0 < share < 1.0
    assert all(statement in (result / "report.html").read_text() for statement in scale["statements"])


def test_measured_motions_are_those_of_the_truth(result: Path, street: Path) -> None:
    truth = read_tum(street / "gt" / "poses_tum.txt").poses
    measured = np.array([[float(row[name]) for name in ("dx", "dy", "dyaw")] for row in rows_of(result)])
    error = measured - se2.between(truth[:-1], truth[1:])
    assert np.sqrt((error[:, :2] ** 2).mean()) < 0.02 and np.sqrt((error[:, 2] ** 2).mean()) < 0.003


def test_the_point_map_carries_the_score_it_is_judged_by(result: Path) -> None:
    vertices = PlyData.read(str(result / "map.ply"))["vertex"]
    assert [p.name for p in vertices.properties] == ["x", "y", "z", "intensity", "time", "psi"]
    summary = read_summary(result)
    assert np.sum(vertices["psi"], dtype=np.float64) == pytest.approx(summary["psi"]["optimised"], rel=1e-4)
    assert np.mean(vertices["psi"], dtype=np.float64) == pytest.approx(summary["psi"]["per_point_optimised"], rel=1e-4)
    assert np.all(vertices["z"] == 0.0) and np.isfinite(vertices["x"]).all() and np.isfinite(vertices["y"]).all()
    seconds = vertices["time"] - 1e-6 * read_tum(result / "trajectory.tum").stamps_us[0]
    assert seconds.min() >= -1e-6 and 11.0 < seconds.max() <= summary["dataset"]["duration_s"]


def test_open3d_reads_the_point_map(result: Path) -> None:
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    cloud = o3d.t.io.read_point_cloud(str(result / "map.ply"))
    vertices = PlyData.read(str(result / "map.ply"))["vertex"]
    np.testing.assert_allclose(cloud.point["positions"].numpy()[:, 0], vertices["x"])
    np.testing.assert_allclose(cloud.point["psi"].numpy().ravel(), vertices["psi"])


def test_the_nav2_map_shows_the_points_where_they_are(result: Path) -> None:
    settings = yaml.safe_load((result / "map.yaml").read_text())
    assert settings["image"] == "map.pgm" and settings["resolution"] == Config().map.cell_m
    header = re.match(rb"P5\s+(?:#.*\n)?(\d+)\s+(\d+)\s+255\s", (result / "map.pgm").read_bytes())
    assert header is not None
    width, height = int(header[1]), int(header[2])
    cells = np.frombuffer((result / "map.pgm").read_bytes()[header.end() :], np.uint8).reshape(height, width)
    vertices = PlyData.read(str(result / "map.ply"))["vertex"]
    points = np.column_stack([vertices["x"], vertices["y"]]).astype(float)
    column, up = np.floor((points - settings["origin"][:2]) / settings["resolution"] + 1e-3).astype(int).T
    occupied = cells[height - 1 - up, column] == 0
    assert occupied.mean() > 0.2 and 0.0 < (cells == 0).mean() < 0.1


def test_the_graph_has_a_vertex_per_scan_and_submap_and_an_edge_per_factor(result: Path) -> None:
    vertices, edges = lines_of(result, "VERTEX_SE2"), lines_of(result, "EDGE_SE2")
    assert [int(v[0]) for v in vertices] == list(range(len(vertices)))
    submaps = len(vertices) - SCANS
    assert 1 < submaps < SCANS
    poses = np.array([[float(word) for word in v[1:]] for v in vertices[:SCANS]])
    apart = poses - read_tum(result / "trajectory.tum").poses
    np.testing.assert_allclose(apart[:, :2], 0.0, atol=1e-5)
    np.testing.assert_allclose(se2.wrap(apart[:, 2]), 0.0, atol=1e-5)
    successive = [(str(k), str(k + 1)) for k in range(SCANS - 1)]
    between_submaps = [(str(SCANS + j), str(SCANS + j + 1)) for j in range(submaps - 1)]
    in_submaps = [(e[0], e[1]) for e in edges if int(e[0]) >= SCANS > int(e[1])]
    assert [int(scan) for _, scan in in_submaps] == list(range(SCANS))
    assert sorted((e[0], e[1]) for e in edges) == sorted(successive + between_submaps + in_submaps)
    assert all(len(e) == 11 and float(e[5]) > 0.0 for e in edges)


def test_the_settings_used_are_written_and_read_back_equal(result: Path, without_odometry: tuple[Path, Path]) -> None:
    measured = set_doppler_beta(load_config(result / "config.yaml"), 0.0)  # a run writes the shift that it has measured
    assert measured == set_doppler_beta(Config(), 0.0)
    out, settings = without_odometry
    written = load_config(out / "config.yaml")
    assert written == load_config(settings) != Config()
    assert written.map.cell_m == 0.5 and written.tracker.sigma_alpha == 0.3
    assert yaml.safe_load((out / "map.yaml").read_text())["resolution"] == 0.5


def test_report_and_log_tell_the_verdict(result: Path) -> None:
    summary = read_summary(result)
    report, log = (result / "report.html").read_text(), (result / "run.log").read_text()
    assert "\ncommand: " in log and "\nversions: Python 3." in log and "gtsam 4" in log and "\nfinished: 20" in log
    assert report.lower().startswith("<!doctype html") and report.rstrip().endswith("</html>")
    assert_alone(result / "report.html")
    assert summary["verdict"]["diagnosis"] in report and summary["verdict"]["reasons"][0] in html.unescape(report)
    assert f"mqslam {summary['mqslam_version']}" in log
    assert f"verdict: pass: {summary['verdict']['diagnosis']}\n" in log


def test_without_odometry_psi_alone_makes_the_trajectory(without_odometry: tuple[Path, Path], street: Path) -> None:
    out, _ = without_odometry
    summary = read_summary(out)
    assert summary["factors"]["odometry"] == 0 and len(lines_of(out, "EDGE_SE2")) == len(lines_of(out, "VERTEX_SE2")) - 1
    assert all(row["psi_odometry"] == "nan" for row in rows_of(out))
    assert error_m(read_tum(out / "trajectory.tum"), read_tum(street / "gt" / "poses_tum.txt")) < 0.5


def test_odometry_of_a_file_replaces_the_recordings(run: Callable[..., Path], quick: Path, street: Path) -> None:
    given = street / "gt" / "poses_tum.txt"
    out = run("--odometry", given, "--config", quick)
    assert read_summary(out)["factors"]["odometry"] == SCANS - 1
    assert error_m(read_tum(out / "odometry.tum"), read_tum(given)) < 1e-4


def test_the_odometry_front_end_follows_the_odometry(run: Callable[..., Path], quick: Path, result: Path) -> None:
    out = run("--frontend", "odometry", "--config", quick)
    summary = read_summary(out)
    assert summary["frontend"] == "odometry" and summary["factors"]["odometry"] == 0
    assert error_m(read_tum(out / "trajectory.tum"), read_tum(result / "odometry.tum")) < 1e-4


def test_kiss_icp_is_run_on_the_same_data(run: Callable[..., Path], quick: Path, street: Path) -> None:
    out = run("--frontend", "kiss_icp", "--config", quick)
    summary = read_summary(out)
    assert summary["frontend"] == "kiss_icp" and summary["verdict"]["status"] in ("pass", "warn", "fail")
    assert {path.name for path in out.iterdir()} == FILES
    truth = read_tum(street / "gt" / "poses_tum.txt")
    assert error_m(read_tum(out / "trajectory.tum"), truth) < 0.1 * truth.length_m


def test_a_finished_run_is_not_resumed(street: Path, result: Path) -> None:
    before = read_contents(result)
    shown = mqslam("run", street, "--out", result, "--resume")
    assert shown.code == 2 and "exists already and holds a finished result" in shown.err and "--resume" not in shown.err
    assert read_contents(result) == before


@pytest.mark.slow
def test_the_number_of_jobs_changes_no_byte(
    street: Path, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workers: list[int] = []

    class Pool(ProcessPoolExecutor):
        def __init__(self, count: int, **options: Any) -> None:
            workers.append(count)
            super().__init__(count, **options)

    monkeypatch.setattr(local_engine, "_WORTH_PROCESSES", 1)
    monkeypatch.setattr(local_engine, "ProcessPoolExecutor", Pool)
    out, options = tmp_path / "out", ("--config", result / "config.yaml", "--quiet", *ALONE)
    assert mqslam("run", street, "--out", out, "--jobs", "2", *options).code == 0 and workers == [2]
    for name in ("trajectory.tum", "odometry.tum", "measurements.csv", "covariances.csv", "graph.g2o", "map.ply", "map.pgm"):
        assert (out / name).read_bytes() == (result / name).read_bytes(), name


def test_json_is_the_summary_and_nothing_else(street: Path, quick: Path, tmp_path: Path) -> None:
    shown = mqslam("run", street, "--out", tmp_path / "out", "--frontend", "odometry", "--config", quick, "--json")
    assert parse_strict_json(shown.out) == read_summary(tmp_path / "out")
    assert shown.err == ""


def test_a_run_shows_progress_a_table_and_the_report(
    street: Path, quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = mqslam("run", street, "--out", "out", "--frontend", "odometry", "--config", quick)
    for title in ("reading and detecting: 48/48", "measuring motion: 48/48", "rendering maps: 2/2"):
        assert title in shown.err
    assert "psi per point" in shown.out and "verdict: " in shown.out and "ATE [m]" in shown.out
    assert all(f"\nnot judged: {line}\n" in shown.out for line in read_summary(tmp_path / "out")["not_judged"])
    sigma_m = read_summary(tmp_path / "out")["last_pose"]["sigma_along_m"]
    assert f"\nlast pose: ± {sigma_m:.2g} m along" in shown.out and "(a prior)" not in shown.out  # nor is there a map
    assert shown.code == 0 and "report: out/report.html" in shown.out.splitlines()[-2:]
    assert "\x1b" not in shown.out + shown.err


def test_force_replaces_an_earlier_result_whole(street: Path, quick: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mended.tum").write_text("gone")
    (out / "notes.txt").write_text("kept")
    done = mqslam("run", street, "--out", out, "--frontend", "odometry", "--config", quick, "--force", "--quiet")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert {path.name for path in out.iterdir()} == FILES | PLACED | {"notes.txt"} and list(tmp_path.iterdir()) == [out]


def test_odometry_that_stops_early_is_not_used_and_said(street: Path, quick: Path, tmp_path: Path) -> None:
    drive = shutil.copytree(street, tmp_path / "drive", ignore=shutil.ignore_patterns("gt", "imu.csv", "gnss.csv"))
    (drive / "odom.csv").write_text("\n".join((street / "odom.csv").read_text().splitlines()[:50]) + "\n")
    shown = mqslam("run", drive, "--out", tmp_path / "out", "--config", quick)
    assert shown.code == 0 and shown.err.count("odometry does not cover the whole recording") == 1
    assert "odometry does not cover the whole recording" in (tmp_path / "out" / "run.log").read_text()
    summary = read_summary(tmp_path / "out")
    assert summary["factors"]["odometry"] == 0 and summary["evaluation"] is None


@pytest.mark.parametrize("kind", mostly_slow(KINDS, ("ros1",)))
def test_a_bag_of_the_same_scans_gives_the_same_trajectory(
    street: Path, without_odometry: tuple[Path, Path], tmp_path: Path, kind: str
) -> None:
    expected, settings = without_odometry
    bag = write_bag(open_recording(street), bag_path(tmp_path, kind), kind)
    options = ["--odometry", "none", "--config", settings, "--range-resolution", "0.175", "--quiet", *ALONE]
    assert mqslam("run", bag, "--out", tmp_path / "out", *options).code == 0
    assert read_summary(tmp_path / "out")["dataset"]["format"] == "rosbag"
    assert (tmp_path / "out" / "trajectory.tum").read_bytes() == (expected / "trajectory.tum").read_bytes()
