from __future__ import annotations

import base64
import io
import json
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
from selenium.webdriver.support.ui import Select, WebDriverWait
from support.reported import (
    PATIENCE_S,
    assert_alone,
    chromium,
    click_curve,
    find_faults,
    judged_walls,
    opened,
    page_of,
    swept_walls,
)

from mqslam.backend.marginals import PoseCovariances
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.errors import OutputError
from mqslam.report import Report, ScanScores, write_report
from mqslam.report.explorers.scene_data import MOST_POINTS
from mqslam.report.figures.run_figures import draw_maps

START_US = 1_600_000_000_000_000


def circle(radius: float, scans: int = 60) -> Trajectory:
    angle = np.linspace(0.0, 2.0 * np.pi, scans)
    poses = np.c_[radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle]
    return Trajectory(START_US + 500_000 * np.arange(scans), poses)


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


def scores(count: int) -> ScanScores:
    rng = np.random.default_rng(12)
    t0 = 1.5 * np.arange(count)
    return ScanScores(
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
            "across_passes_odometry": None,
            "across_passes_optimised": None,
            "matched_odometry": 0.71,
            "matched_optimised": 0.82,
        },
        "verdict": {"status": "warn", "reasons": ["torn near t = 31 s & 40 s"]},
        "factors": {"odometry": 59, "psi": 20, "loop": 0, "loop_rejected": 0, "refinement": 0},
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
        scores=scores(20),
        before="odometry",
        checks=tuple(judged_walls(swept_walls()).windows),
        settings=AuditConfig(),
        loops=np.array([[0, 59]]),
        covariances=PoseCovariances(np.array([0, 30, 59]), np.diag([0.04, 0.09, 1e-4]) * np.arange(1, 4)[:, None, None]),
        warnings=("polar scan 7 <img src=x> is truncated", "odometry ends & the run goes on"),
        settings_yaml="detector:\n  k_strongest: 12  # <per azimuth>\n",
    )


def scene_of(path: Path) -> str:
    """Returns the names of the lines on the map to move in."""
    scene = re.search(r'<script type="application/json" id="scene">(.*?)</script>', path.read_text(), re.DOTALL)
    assert scene is not None
    return ", ".join(line["name"] for line in json.loads(scene[1])["lines"])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, a_report())
    return path


def test_the_page_needs_nothing_from_outside(written: Path) -> None:
    assert_alone(written)


def test_both_maps_and_all_curves_are_pictures_of_one_size_each(written: Path) -> None:
    images = page_of(written).images
    assert set(images) == {"Under odometry", "Optimised", "Trajectory"}
    assert {"ψ per scan", "Matched share"} <= set(page_of(written).drawings)
    before, after = (Image.open(io.BytesIO(images[name])) for name in ("Under odometry", "Optimised"))
    assert before.size == after.size
    assert images["Under odometry"] != images["Optimised"]


def test_the_verdict_stands_before_the_warnings_which_are_escaped(written: Path) -> None:
    text = page_of(written).text
    first = text.index("polar scan 7 <img src=x> is truncated")
    assert text.index("warn\n") < text.index("torn near t = 31 s & 40 s") < first < text.index("Map quality")
    assert text.index("warn\nSomething is wrong with this map or the run") < first
    assert "<img src=x>" not in written.read_text(encoding="utf-8")


@pytest.mark.parametrize("unjudged", [[], ["drift"]])
def test_a_pass_promises_no_more_than_was_judged(tmp_path: Path, unjudged: list[str]) -> None:
    report = a_report()
    summary = {
        **report.summary,
        "verdict": {"status": "pass", "reasons": ["0 of 10 windows are torn"]},
        "not_judged": unjudged,
    }
    write_report(tmp_path / "passed.html", replace(report, summary=summary))
    text = page_of(tmp_path / "passed.html").text
    assert ("the tests would have shown a bad one" in text) is not bool(unjudged)
    assert ("what could not be judged stands below" in text) is bool(unjudged)


def test_notes_on_the_recording_stand_below_the_warnings(written: Path, tmp_path: Path) -> None:
    note = "range resolution 0.0438 m is <assumed>"
    write_report(tmp_path / "noted.html", replace(a_report(), notes=(note,)))
    text = page_of(tmp_path / "noted.html").text
    assert text.index("warn\n") < text.index("odometry ends & the run goes on") < text.index(note)
    assert "Notes" not in page_of(written).text


def test_psi_across_passes_comes_first_where_places_were_passed_twice(written: Path, tmp_path: Path) -> None:
    report = a_report()
    psi = report.summary["psi"] | {"across_passes_odometry": 0.8, "across_passes_optimised": 0.4875}
    write_report(tmp_path / "twice.html", replace(report, summary={**report.summary, "psi": psi}))
    text = re.sub(r"\n+", "\n", page_of(tmp_path / "twice.html").text)
    assert text.index("0.487\nψ per point across passes") < text.index("ψ per point of the optimised map")
    assert "ψ per point across passes\n0.8\n0.487\n−39.1 %" in text
    assert "across passes" not in page_of(written).text


def test_the_map_of_a_radar_that_stood_still_is_not_judged(tmp_path: Path) -> None:
    report = a_report()
    psi = report.summary["psi"] | {"matched_optimised": 0.0, "per_point_optimised": 2.25}
    still = replace(report, summary={**report.summary, "psi": psi}, stood_still=True)
    write_report(tmp_path / "still.html", still)
    text = re.sub(r"\n+", "\n", page_of(tmp_path / "still.html").text)
    assert "not judged\nψ and matched points: the radar stood still" in text
    assert "points matched\n71 %\nnot judged\n–" in text and "%\nof its points matched" not in text
    assert "the optimised map holds the returns of one scan only" in text


def test_numbers_of_the_summary_are_shown_with_units(written: Path) -> None:
    text = page_of(written).text
    for shown in (
        "0.0248",
        "−25.0 %",
        "82 %",
        "0.312 m",
        "0.41 °/100 m",
        "812 MB",
        "/data/<run>",
        "20 scans: 19 converged, 1 lost",
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
    bare = replace(
        a_report(),
        summary={"evaluation": None},
        ground_truth=None,
        map_odometry=PointMap.empty(),
        map_optimised=PointMap.empty(),
        scores=scores(0),
        warnings=(),
    )
    write_report(tmp_path / "bare.html", bare)
    page = page_of(tmp_path / "bare.html")
    assert "no verdict" in page.text
    assert "Warnings" not in page.text
    assert "Against ground truth" not in page.text
    assert set(page.images) == {"Under odometry", "Optimised", "Trajectory"}
    assert "Error over distance" not in page.drawings


def test_a_part_that_cannot_be_drawn_costs_no_other_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mqslam.report.run_page.explore_run", lambda *_: 1 / 0)
    failures = write_report(tmp_path / "partial.html", a_report())
    assert failures == [
        "the map to move in could not be made (ZeroDivisionError: division by zero); the other results are whole"
    ]
    page = page_of(tmp_path / "partial.html")
    assert page.text.count(failures[0]) == 2  # among the warnings, and in the part's place
    assert "Map quality" in page.text and {"Under odometry", "Optimised", "Trajectory"} <= set(page.images)


def test_a_full_disk_is_no_part_that_cannot_be_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> str:
        raise OutputError("no space left")

    monkeypatch.setattr("mqslam.report.run_page.explore_run", full)
    with pytest.raises(OutputError, match="no space left"):
        write_report(tmp_path / "partial.html", a_report())


def test_covariances_that_are_not_known_are_said_and_not_drawn(written: Path, tmp_path: Path) -> None:
    unknown = PoseCovariances.unknown("the graph leaves a direction undetermined")
    write_report(tmp_path / "unsure.html", replace(a_report(), covariances=unknown))
    said = "the covariances of the poses are not known (the graph leaves a direction undetermined)"
    assert said in page_of(tmp_path / "unsure.html").text and said not in page_of(written).text
    assert "3σ ellipses" not in scene_of(tmp_path / "unsure.html") and "3σ ellipses" in scene_of(written)


@pytest.mark.parametrize("empty", ["map_odometry", "map_optimised"])
def test_one_map_that_could_not_be_rendered_leaves_the_other_to_be_looked_at(tmp_path: Path, empty: str) -> None:
    assert write_report(tmp_path / "half.html", replace(a_report(), **{empty: PointMap.empty()})) == []
    page = page_of(tmp_path / "half.html")
    assert len(page.images) == 3 and {"ψ per scan", "Matched share"} <= set(page.drawings)


def test_scans_without_odometry_have_one_curve(tmp_path: Path) -> None:
    report = a_report()
    lone = replace(report.scores, psi_odometry=np.full(20, np.nan))
    write_report(tmp_path / "lone.html", replace(report, scores=lone))
    assert "ψ per scan" in page_of(tmp_path / "lone.html").drawings


def test_maps_share_scale_and_shade() -> None:
    path = circle(1.0)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    dense = replace(walls(0.0, 400), points=np.repeat(20.0 * corners, 100, axis=0))
    sparse = replace(walls(0.0, 4), points=40.0 * corners)
    images = draw_maps((dense, sparse), (path, path), ("#ff0000", "#ff0000"))
    inks = [inside_axes(png) for png in images]
    spans = [np.ptp(np.nonzero(ink)[0]) for ink in inks]
    assert spans[1] == pytest.approx(2 * spans[0], abs=4)
    assert inks[0].max() == 255
    assert 80 < inks[1].max() < 150


def inside_axes(png: bytes) -> NDArray[np.int64]:
    """Returns the opacity (H, W) of the points drawn: neither axes, nor grid, nor the red path."""
    image = np.asarray(Image.open(io.BytesIO(png))).astype(int)[30:-110, 170:-30]
    return np.where((image[..., 3] > 70) & (image[..., 0] < 60), image[..., 3], 0)


@pytest.mark.slow
def test_a_million_points_stay_under_six_megabytes(tmp_path: Path) -> None:
    report = a_report()
    many = walls(20.0, 1_000_000)
    write_report(tmp_path / "many.html", replace(report, map_odometry=many, map_optimised=many, scores=scores(1200)))
    assert (tmp_path / "many.html").stat().st_size < 6_000_000


def test_importing_the_report_does_not_load_matplotlib() -> None:
    code = "import sys, mqslam.report; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_click_on_a_curve_shows_the_place_before_and_after(written: Path) -> None:
    with chromium() as browser:
        opened(browser, written)
        assert browser.find_element("tag name", "h1").text == "kaist <01>"
        assert browser.find_element("id", "place").text.startswith("4.5 s to 6.0 s, inflation 120")  # the worst of them
        time = click_curve(browser, "inflation", 0)
        shown = browser.find_element("id", "place")
        WebDriverWait(browser, PATIENCE_S).until(lambda _: shown.text.startswith(f"{time - 0.75:.1f} s to"))
        crops = browser.execute_script("return document.getElementById('crop').data.map((t) => [t.name, t.x.length])")
        assert [name for name, _ in crops] == ["this pass", "other passes"] * 2 and sum(count for _, count in crops) > 0
        marked = browser.execute_script("return document.getElementById('map').data.at(-1).x.length")
        assert marked == 2
        browser.find_element("id", "next").click()
        WebDriverWait(browser, PATIENCE_S).until(lambda _: not shown.text.startswith(f"{time - 0.75:.1f} s to"))
        assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.parametrize("by", ["time", "psi", "intensity"])
def test_the_map_takes_the_colours_of_what_is_chosen(written: Path, by: str) -> None:
    with chromium() as browser:
        opened(browser, written)
        Select(browser.find_element("id", "colour")).select_by_value(by)
        script = "const m = document.getElementById('map').data[1].marker; return [m.cmin, m.cmax, Array.from(m.color)]"
        low, high, colours = browser.execute_script(script)
        drawn = a_report().map_optimised
        values = {"time": drawn.times, "psi": drawn.psi, "intensity": drawn.intensities}[by]
        assert low == pytest.approx(values.min()) and high <= values.max() + 1e-6 and high > low
        np.testing.assert_allclose(colours, np.clip(values, low, high), atol=1.01 * (high - low) / 255.0)
        assert browser.get_log("browser") == []


@pytest.mark.slow
def test_in_print_and_without_scripts_the_pictures_stand_for_the_map(written: Path) -> None:
    with chromium() as browser:
        opened(browser, written)
        live, still = (browser.find_element("class name", name) for name in ("live", "still"))
        assert live.is_displayed() and not still.is_displayed()
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        assert still.is_displayed() and not live.is_displayed()
    assert 'class="live"' in written.read_text(encoding="utf-8") and "Under odometry" in page_of(written).images


@pytest.mark.slow
def test_on_a_phone_nothing_is_wider_than_the_screen(written: Path) -> None:
    with chromium(500, 900) as browser:
        opened(browser, written)
        assert browser.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")


def test_a_map_of_many_points_is_thinned_evenly_and_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(0.0, 200.0, (400_000, 2))
    big = PointMap(points, np.arange(4e5) * 1e-3, np.full(400_000, 80.0), rng.random(400_000), np.ones(400_000, bool))
    write_report(tmp_path / "big.html", replace(a_report(), map_odometry=big, map_optimised=big))
    text = (tmp_path / "big.html").read_text(encoding="utf-8")
    assert len(text) < 6e6
    shown = int(re.search(r"([\d,]+) of 800,000 points of all maps are shown", text)[1].replace(",", ""))
    assert 0.8 * MOST_POINTS < shown <= MOST_POINTS
    scene = json.loads(re.search(r'id="scene">(.*?)</script>', text, re.DOTALL)[1])
    stored = scene["layers"][0]["x"]
    x = stored["low"] + stored["step"] * np.frombuffer(base64.b64decode(stored["data"]), "<u2")
    counts, _ = np.histogram(x, 10, (0.0, 200.0))
    assert counts.min() > 0.9 * counts.max()


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault(written: Path, scheme: str, width: int) -> None:
    assert find_faults(written, scheme, width) == []
