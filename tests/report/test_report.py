from __future__ import annotations

import io
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from reported import page_of, seen_by_chromium

from mqslam import se2
from mqslam.pointmap import PointMap
from mqslam.report import Report, WindowScores, write_report
from mqslam.report.figures import map_figures
from mqslam.trajectory import Trajectory

START_US = 1_600_000_000_000_000


def circle(radius: float, revolutions: int = 60) -> Trajectory:
    angle = np.linspace(0.0, 2.0 * np.pi, revolutions)
    poses = np.c_[radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle]
    return Trajectory(START_US + 500_000 * np.arange(revolutions), poses)


def walls(offset: float, count: int = 4000) -> PointMap:
    rng = np.random.default_rng(11)
    points = np.c_[rng.uniform(-60.0, 60.0, count), rng.choice([-30.0, 90.0], count) + offset * rng.normal(size=count)]
    return PointMap(
        points,
        np.sort(rng.uniform(0, 30, count)),
        rng.uniform(60, 255, count),
        rng.random(count),
        rng.random(count) < 0.8,
    )


def windows(count: int) -> WindowScores:
    rng = np.random.default_rng(12)
    t0 = 1.5 * np.arange(count)
    return WindowScores(
        t0=t0,
        t1=t0 + 1.5,
        psi_minimum=rng.uniform(20.0, 30.0, count),
        psi_odometry=rng.uniform(30.0, 45.0, count),
        points=rng.integers(900, 1100, count),
        matched=rng.uniform(0.7, 0.9, count),
        status=tuple("lost" if k == 3 else "converged" for k in range(count)),
    )


def a_report() -> Report:
    summary: dict[str, Any] = {
        "mqslam_version": "9.8.7",
        "dataset": {
            "format": "oxford",
            "path": "/data/<run>",
            "revolutions": 60,
            "duration_s": 30.0,
            "length_m": 251.3,
        },
        "psi": {
            "odometry": 132.0,
            "optimised": 99.0,
            "per_point_odometry": 0.033,
            "per_point_optimised": 0.02475,
            "matched_odometry": 0.71,
            "matched_optimised": 0.82,
        },
        "verdict": {"status": "warn", "reasons": ["torn near t = 31 s & 40 s"]},
        "factors": {"odometry": 59, "psi": 20, "loop": 0, "loop_rejected": 0},
        "evaluation": {"ate_rmse_m": 0.312, "drift_percent": None, "drift_deg_per_100m": 0.41},
        "runtime_s": {"read": 1.2, "total": 29.1},
        "peak_rss_mb": 812.5,
    }
    truth = circle(40.0)
    return Report(
        title="kaist <01>",
        summary=summary,
        odometry=circle(42.0),
        optimised=circle(40.1),
        ground_truth=Trajectory(truth.stamps_us, se2.compose(np.array([500.0, 300.0, 1.0]), truth.poses)),
        map_odometry=walls(3.0),
        map_optimised=walls(0.2),
        windows=windows(20),
        warnings=("revolution 7 <img src=x> is truncated", "odometry ends & the run goes on"),
        settings_yaml="detector:\n  k_strongest: 12  # <per azimuth>\n",
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, a_report())
    return path


def test_the_page_needs_nothing_from_outside(written: Path) -> None:
    page = page_of(written)
    assert page.addresses
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert not re.search(r"https?://|url\(|@import", written.read_text(encoding="utf-8"))


def test_both_maps_and_all_curves_are_pictures_of_one_size_each(written: Path) -> None:
    images = page_of(written).images
    assert set(images) == {"Under odometry", "Optimised", "Trajectory", "ψ per window", "Matched share"}
    before, after = (Image.open(io.BytesIO(images[name])) for name in ("Under odometry", "Optimised"))
    assert before.size == after.size
    assert images["Under odometry"] != images["Optimised"]


def test_warnings_stand_before_the_verdict_and_are_escaped(written: Path) -> None:
    text = page_of(written).text
    first = text.index("revolution 7 <img src=x> is truncated")
    assert first < text.index("warn\n") < text.index("torn near t = 31 s & 40 s") < text.index("Map quality")
    assert "<img src=x>" not in written.read_text(encoding="utf-8")


def test_numbers_of_the_summary_are_shown_with_units(written: Path) -> None:
    text = page_of(written).text
    for shown in (
        "0.02475",
        "−25.0 %",
        "82 %",
        "0.312 m",
        "0.41 °/100 m",
        "812.5 MB",
        "/data/<run>",
        "20 windows: 19 converged, 1 lost",
    ):
        assert shown in text, shown
    assert "drift\n–" in re.sub(r"\n+", "\n", text)


def test_settings_and_versions_are_listed(written: Path) -> None:
    text = page_of(written).text
    assert "k_strongest: 12  # <per azimuth>" in text
    assert "mqslam 9.8.7" in text
    assert f"numpy {np.__version__}" in text


def test_the_same_run_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    write_report(tmp_path / "again.html", a_report())
    assert (tmp_path / "again.html").read_bytes() == written.read_bytes()


def test_a_run_that_optimisation_did_not_change_says_so(written: Path, tmp_path: Path) -> None:
    report = a_report()
    same = replace(report, odometry=report.optimised, map_odometry=report.map_optimised)
    write_report(tmp_path / "same.html", same)
    assert "both maps are the same" in page_of(tmp_path / "same.html").text
    assert "both maps are the same" not in page_of(written).text


def test_a_run_with_almost_nothing_in_it_still_has_a_report(tmp_path: Path) -> None:
    nothing = np.empty(0)
    empty = PointMap(np.empty((0, 2)), nothing, nothing, nothing, np.empty(0, dtype=np.bool_))
    bare = replace(
        a_report(),
        summary={"evaluation": None},
        ground_truth=None,
        map_odometry=empty,
        map_optimised=empty,
        windows=windows(0),
        warnings=(),
    )
    write_report(tmp_path / "bare.html", bare)
    page = page_of(tmp_path / "bare.html")
    assert "no verdict" in page.text
    assert "Warnings" not in page.text
    assert "Against ground truth" not in page.text
    assert set(page.images) == {"Under odometry", "Optimised", "Trajectory"}


def test_windows_without_odometry_have_one_curve(tmp_path: Path) -> None:
    report = a_report()
    lone = replace(report.windows, psi_odometry=np.full(20, np.nan))
    write_report(tmp_path / "lone.html", replace(report, windows=lone))
    assert "ψ per window" in page_of(tmp_path / "lone.html").images


def test_maps_share_scale_and_shade() -> None:
    path = circle(1.0)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    dense = replace(walls(0.0, 400), points=np.repeat(20.0 * corners, 100, axis=0))
    sparse = replace(walls(0.0, 4), points=40.0 * corners)
    images = map_figures((dense, sparse), (path, path), ("#ff0000", "#ff0000"))
    inks = [inside_axes(png) for png in images]
    spans = [np.ptp(np.nonzero(ink)[0]) for ink in inks]
    assert spans[1] == pytest.approx(2 * spans[0], abs=4)
    assert inks[0].max() == 255
    assert 80 < inks[1].max() < 150


def inside_axes(png: bytes) -> NDArray[np.int64]:
    """Opacity (H, W) of the points drawn: neither axes, nor grid, nor the red path."""
    image = np.asarray(Image.open(io.BytesIO(png))).astype(int)[30:-110, 170:-30]
    return np.where((image[..., 3] > 70) & (image[..., 0] < 60), image[..., 3], 0)


def test_a_million_points_stay_under_fifteen_megabytes(tmp_path: Path) -> None:
    report = a_report()
    many = walls(20.0, 1_000_000)
    write_report(tmp_path / "many.html", replace(report, map_odometry=many, map_optimised=many, windows=windows(1200)))
    assert (tmp_path / "many.html").stat().st_size < 15_000_000


def test_importing_the_report_does_not_load_matplotlib() -> None:
    code = "import sys, mqslam.report; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_chromium_opens_the_page_without_a_console_message(written: Path, tmp_path: Path) -> None:
    seen = seen_by_chromium(written, tmp_path / "profile")
    assert seen.count("<img ") == 5
    assert "kaist &lt;01&gt;" in seen
