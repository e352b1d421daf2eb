"""What the page of a run shows besides what all pages have."""

from __future__ import annotations

import base64
import io
import json
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image
from selenium.webdriver.support.ui import Select, WebDriverWait
from support.pages import RUN_SUMMARY, START_US, a_run, circle, measured, scene_of, text_of, walls, write_run
from support.reported import PATIENCE_S, chromium, click_curve, opened, page_of

from mqslam.backend.marginals import PoseCovariances
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.report import canvas
from mqslam.report.canvas import Chart, Curve, draw_ellipses, over
from mqslam.report.explorer import MOST_CROPPED, MOST_POINTS
from mqslam.report.page import Figure
from mqslam.report.run_page import chart_path, draw_maps, explore_run

PICTURES = {"Map", "Under odometry", "Optimised", "Trajectory"}


def along(scale: float, scans: int = 240) -> Trajectory:
    return Trajectory(START_US + 250_000 * np.arange(scans), np.c_[scale * 1.25 * np.arange(scans), np.zeros((scans, 2))])


def charts_of(truth: Trajectory | None = None, **changed: Any) -> dict[str, Figure]:
    section = chart_path(a_run(odometry=along(1.05), optimised=along(1.0), **changed), truth)
    assert section is not None
    return {figure.heading: figure for figure in section.figures}


def words_of(figure: Figure) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", figure.picture.decode())


def test_both_maps_and_all_curves_are_pictures_of_one_size_each(pages: dict[str, Path]) -> None:
    page = page_of(pages["run"] / "report.html")
    assert set(page.images) == PICTURES
    assert {"ψ per scan", "Matched share"} <= set(page.drawings)
    before, after = (Image.open(io.BytesIO(page.images[name])) for name in ("Under odometry", "Optimised"))
    assert before.size == after.size
    assert page.images["Under odometry"] != page.images["Optimised"]


def test_notes_on_the_recording_stand_below_the_warnings(pages: dict[str, Path], tmp_path: Path) -> None:
    note = "range resolution 0.0438 m is <assumed>"
    write_run(tmp_path, notes=(note,))
    text = text_of(tmp_path)
    assert text.index("warn\n") < text.index("odometry ends & the run goes on") < text.index(note)
    assert "its uncertainty is not known" in text_of(pages["run"])


def test_psi_is_shown_across_passes_only(pages: dict[str, Path], tmp_path: Path) -> None:
    psi = RUN_SUMMARY["psi"] | {"across_passes_odometry": 0.8, "across_passes_optimised": 0.4875}
    write_run(tmp_path, {**RUN_SUMMARY, "psi": psi})
    text = text_of(tmp_path)
    assert "ψ per point across passes\n0.8 → 0.487 (−39.1 %)" in text
    assert "across passes" not in text_of(pages["run"])
    for value in ("0.033", "0.0248", "132", "−25.0 %"):  # psi of the whole map
        assert value not in text


def test_the_map_of_a_radar_that_stood_still_is_not_judged(tmp_path: Path) -> None:
    psi = RUN_SUMMARY["psi"] | {"matched_optimised": 0.0, "per_point_optimised": 2.25}
    write_run(tmp_path, {**RUN_SUMMARY, "psi": psi}, optimised=along(0.0))
    text = text_of(tmp_path)
    assert "points matched\n71 % → not judged" in text and "%\nof its points matched" not in text
    assert "the optimised map holds the returns of one scan only" in text


def test_ellipses_wait_for_their_name_in_the_legend(pages: dict[str, Path]) -> None:
    (ellipses,) = (line for line in scene_of(pages["run"])["lines"] if line["name"].startswith("3σ ellipses"))
    assert ellipses["shown"] is False
    assert ellipses["name"] == "3σ ellipses"
    small = np.array([1e-4 * np.eye(3)])  # 3σ are 0.03 m; the most that is drawn is 0.159 m, 1.5 % of the picture's 10.6 m
    curve, largest = draw_ellipses(np.zeros((1, 2)), small, [np.array([[0.0, 0.0], [10.0, 0.0]])])
    assert curve.name == "3σ ellipses, drawn 5 times as large" and largest == pytest.approx(0.03)
    assert np.nanmax(np.abs(curve.points)) == pytest.approx(0.15)


def test_ellipses_that_would_cover_a_short_path_are_left_out() -> None:
    path = np.c_[np.linspace(0.0, 1.0, 21), np.zeros(21)]
    curve, largest = draw_ellipses(path, np.tile(0.0081 * np.eye(2), (21, 1, 1)), [path])
    assert curve.name == "3σ ellipses" and largest == pytest.approx(0.27)
    middles = np.nanmean(curve.points.reshape(2, -1, 2)[:, 1:], axis=1)  # the first corner of an ellipse is its last, too
    np.testing.assert_allclose(middles, [[0.45, 0.0], [1.0, 0.0]], atol=1e-9)  # the last pose has one, and one 0.55 m before


def test_scans_with_almost_the_same_stamp_do_not_spoil_the_chart_of_speeds() -> None:
    steady = along(1.0)
    stamps_us = steady.stamps_us.copy()
    stamps_us[5] = stamps_us[6] - 1000  # the 1.25 m from scan 5 to scan 6 take a millisecond
    highest, captions = [], []
    for stamps in (steady.stamps_us, stamps_us):
        section = chart_path(a_run(optimised=replace(steady, stamps_us=stamps)), None)
        assert section is not None
        chart = {figure.heading: figure for figure in section.figures}["Speed and yaw rate"]
        highest.append(max(float(word) for word in words_of(chart) if word.replace(".", "", 1).isdigit()))
        captions.append(chart.caption)
    assert highest[0] == highest[1] == 300.0  # metres of path; the speed is 5 m/s
    assert captions[1] == f"{captions[0]}, over at least 0.12 s where stamps are closer"


def test_numbers_of_the_summary_are_shown_with_units_and_angles_in_degrees(pages: dict[str, Path]) -> None:
    text = text_of(pages["run"])
    for shown in ("71 % → 82 % (+15.5 %)", "0.312 m", "0.41 °/100 m", "812 MB"):
        assert shown in text, shown
    assert "20 motions between 21 scans: 19 converged, 1 lost" in text
    assert "drift\n–" in text and "scans used\n60" in text and "revolutions" not in text
    assert "bias\n2 °/s" in text and "turns its end by\n1 °" in text and "yaw rate error, RMS\n3 °/s" in text
    assert "moves the trajectory by (RMS)\n0.25 m" in text and "GNSS" not in text
    assert " rad" not in text[text.index("Numbers") : text.index("Settings")]


def test_a_run_that_optimisation_did_not_change_says_so(pages: dict[str, Path], tmp_path: Path) -> None:
    write_run(tmp_path, odometry=circle(40.1))
    assert "both maps are the same" in text_of(tmp_path) and "both maps are the same" not in text_of(pages["run"])


def test_a_run_with_almost_nothing_in_it_still_has_a_report(tmp_path: Path) -> None:
    empty = PointMap.empty()
    assert write_run(tmp_path, {"evaluation": None}, None, map_odometry=empty, map_optimised=empty, measurements=[]) == []
    page = page_of(tmp_path / "report.html")
    assert "Warnings" not in page.text and "Against ground truth" not in page.text
    assert set(page.images) == PICTURES and "Error over distance" not in page.drawings


def test_covariances_that_are_not_known_are_said_and_not_drawn(pages: dict[str, Path], tmp_path: Path) -> None:
    write_run(tmp_path, covariances=PoseCovariances.unknown("the graph leaves a direction undetermined"))
    said = "the covariances of the poses are not known (the graph leaves a direction undetermined)"
    for folder, is_known in ((tmp_path, False), (pages["run"], True)):
        assert (said not in text_of(folder)) is is_known
        assert any(line["name"].startswith("3σ ellipses") for line in scene_of(folder)["lines"]) is is_known


@pytest.mark.parametrize("empty", ["map_odometry", "map_optimised"])
def test_one_map_that_could_not_be_rendered_leaves_the_other_to_be_looked_at(tmp_path: Path, empty: str) -> None:
    assert write_run(tmp_path, **{empty: PointMap.empty()}) == []
    page = page_of(tmp_path / "report.html")
    assert len(page.images) == 4 and {"ψ per scan", "Matched share"} <= set(page.drawings)


def test_scans_without_odometry_have_one_curve(tmp_path: Path) -> None:
    assert write_run(tmp_path, measurements=measured(20, with_odometry=False)) == []
    assert [curve["name"] for curve in scene_of(tmp_path)["charts"][0]["curves"]] == ["ψ at its minimum"]
    assert "ψ per scan" in page_of(tmp_path / "report.html").drawings


def test_maps_share_scale_and_shade() -> None:
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    dense = replace(walls(0.0, 400), points=np.repeat(20.0 * corners, 100, axis=0))
    sparse = replace(walls(0.0, 4), points=40.0 * corners)
    inks = [inside_axes(png) for png in draw_maps([(drawn, circle(1.0), "#ff0000") for drawn in (dense, sparse)])]
    spans = [np.ptp(np.nonzero(ink)[0]) for ink in inks]
    assert spans[1] == pytest.approx(2 * spans[0], abs=4)
    assert inks[0].max() == 255
    assert 80 < inks[1].max() < 150


def inside_axes(png: bytes) -> NDArray[np.int64]:
    """Returns the opacity (H, W) of the points drawn: neither axes, nor grid, nor the red path."""
    image = np.asarray(Image.open(io.BytesIO(png))).astype(int)[30:-110, 170:-30]
    return np.where((image[..., 3] > 70) & (image[..., 0] < 60), image[..., 3], 0)


def test_all_that_is_looked_for_along_a_path_is_drawn_and_its_words_stay_words() -> None:
    sure = PoseCovariances(np.array([0, 120, 239]), np.tile(np.diag([0.04, 0.09, 1e-4]), (3, 1, 1)))
    charts = charts_of(along(1.0), covariances=sure)
    assert list(charts) == [
        "Error over distance",
        "Drift by segment length",
        "Correction over distance",
        "Speed and yaw rate",
        "Covariance along the path",
    ]
    assert {"odometry: translation", "optimised: rotation"} <= set(words_of(charts["Drift by segment length"]))
    assert {"along", "across", "heading"} <= set(words_of(charts["Covariance along the path"]))
    assert "100 m to 200 m" in charts["Drift by segment length"].caption


def test_without_truth_and_covariances_what_is_known_along_the_path_remains() -> None:
    assert list(charts_of(covariances=PoseCovariances.unknown("singular"))) == [
        "Correction over distance",
        "Speed and yaw rate",
    ]
    assert chart_path(a_run(optimised=along(1.0, 1)), None) is None


def test_a_run_that_optimisation_left_as_it_was_shows_no_correction_and_each_place_once(tmp_path: Path) -> None:
    same = along(1.0)
    off = replace(same, poses=same.poses + 1e-13)
    section = chart_path(a_run(odometry=off, optimised=same), None)
    assert section is not None and "Correction over distance" not in {figure.heading for figure in section.figures}
    write_run(tmp_path, odometry=circle(42.0), optimised=circle(42.0))
    views = {tuple(view["name"] for view in place["views"]) for place in scene_of(tmp_path)["places"]}
    assert views == {("optimised",)}


def test_a_line_stands_above_the_map_and_the_rest_unfolds(pages: dict[str, Path]) -> None:
    page = (pages["run"] / "report.html").read_text(encoding="utf-8")
    head = page[page.index('<section class="live">') : page.index('<div id="legend"')]
    before, folded = head.split('<details class="how"><summary>How to read this</summary>')
    assert before.count("<p") == 1 and "Click a dot" in before and "is torn where its inflation" in folded


def test_a_map_of_many_points_is_thinned_evenly_and_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(0.0, 200.0, (400_000, 2))
    big = PointMap(points, np.arange(4e5) * 1e-3, np.full(400_000, 80.0), rng.random(400_000), np.ones(400_000, bool))
    write_run(tmp_path, map_odometry=big, map_optimised=big)
    assert (tmp_path / "report.html").stat().st_size < 6e6
    said = re.search(r"([\d,]+) of 800,000 points of all maps are shown", text_of(tmp_path))
    assert said is not None and 0.8 * MOST_POINTS < int(said[1].replace(",", "")) <= MOST_POINTS
    stored = scene_of(tmp_path)["layers"][0]["x"]
    x = stored["low"] + stored["step"] * np.frombuffer(base64.b64decode(stored["data"]), "<u2")
    counts, _ = np.histogram(x, 10, (0.0, 200.0))
    assert counts.min() > 0.9 * counts.max()


def test_close_views_of_many_windows_that_show_the_same_room_do_not_fill_the_memory() -> None:
    """Each of 80 windows shows all points: together they would take half a gigabyte in each of the two maps."""
    points = np.random.default_rng(4).uniform(-20.0, 20.0, (400_000, 2))
    room = PointMap(points, np.arange(4e5) * 1e-3, np.full(400_000, 80.0), np.ones(400_000), np.ones(400_000, bool))
    first = a_run().checks[0]
    run = a_run(map_odometry=room, map_optimised=room, checks=[first] * 80, odometry=along(0.0), optimised=along(1e-3))
    tracemalloc.start()
    try:
        page = explore_run(run, RUN_SUMMARY, None)
        peak_mb = 1e-6 * tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert page is not None and peak_mb < 300.0
    crops = json.loads(page.data)["crops"]
    shown = len(base64.b64decode(crops["data"])) // 4
    assert 0.5 * MOST_CROPPED < shown <= MOST_CROPPED


@pytest.mark.slow
def test_a_million_points_stay_under_six_megabytes(tmp_path: Path) -> None:
    many = walls(20.0, 1_000_000)
    write_run(tmp_path, map_odometry=many, map_optimised=many, measurements=measured(1200))
    assert (tmp_path / "report.html").stat().st_size < 6_000_000


def test_a_click_on_a_curve_shows_the_place_before_and_after(pages: dict[str, Path]) -> None:
    with chromium() as browser:
        opened(browser, pages["run"] / "report.html")
        assert browser.find_element("tag name", "h1").text == "<run>"
        assert browser.find_element("id", "place").text.startswith("window 4.5 s to 6.0 s at (")  # the worst of them
        time = click_curve(browser, "inflation", 0)
        shown = browser.find_element("id", "place")
        WebDriverWait(browser, PATIENCE_S).until(lambda _: shown.text.startswith(f"window {time - 0.75:.1f} s to"))
        crops = browser.execute_script("return document.getElementById('crop').data.map((t) => [t.name, t.x.length])")
        assert [name for name, _ in crops] == ["seen within 15 s", "seen earlier or later"] * 2
        assert sum(count for _, count in crops) > 0
        marked = browser.execute_script("return document.getElementById('map').data.at(-1).x.length")
        assert marked == 2
        browser.find_element("id", "next").click()
        WebDriverWait(browser, PATIENCE_S).until(lambda _: not shown.text.startswith(f"window {time - 0.75:.1f} s to"))
        assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.parametrize("by", ["time", "psi", "intensity"])
def test_the_map_takes_the_colours_of_what_is_chosen(pages: dict[str, Path], by: str) -> None:
    with chromium() as browser:
        opened(browser, pages["run"] / "report.html")
        Select(browser.find_element("id", "colour")).select_by_value(by)
        script = "const m = document.getElementById('map').data[1].marker; return [m.cmin, m.cmax, Array.from(m.color)]"
        low, high, colours = browser.execute_script(script)
        drawn = a_run().map_optimised
        values = {"time": drawn.times, "psi": drawn.psi, "intensity": drawn.intensities}[by]
        assert low == pytest.approx(values.min()) and high <= values.max() + 1e-6 and high > low
        np.testing.assert_allclose(colours, np.clip(values, low, high), atol=1.01 * (high - low) / 255.0)
        assert browser.get_log("browser") == []


@pytest.mark.slow
def test_it_prints_on_a4(pages: dict[str, Path]) -> None:
    with chromium() as browser:
        opened(browser, pages["run"] / "report.html")
        printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", base64.b64decode(printed))
    assert boxes and all((round(float(w)), round(float(h))) == (595, 842) for w, h in boxes)


@pytest.mark.slow
def test_a_long_path_does_not_cut_the_numbers_beside_it_in_print(tmp_path: Path) -> None:
    write_run(tmp_path, {**RUN_SUMMARY, "dataset": {**RUN_SUMMARY["dataset"], "path": f"/data/{'long' * 20}.log.gz"}})
    with chromium(width=700) as browser:
        opened(browser, tmp_path / "report.html")
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        wide = "const numbers = document.querySelector('.dense'); return [numbers.scrollWidth, numbers.clientWidth]"
        needed, given = browser.execute_script(wide)
    assert needed <= given


@pytest.mark.slow
def test_the_keyboard_moves_the_map_and_its_legend_hides_what_it_names(pages: dict[str, Path]) -> None:
    range_of = "return document.getElementById('map')._fullLayout.xaxis.range.map(Number)"
    with chromium() as browser:
        opened(browser, pages["run"] / "report.html")
        low, high = browser.execute_script(range_of)
        shown = browser.find_element("id", "map")
        shown.send_keys("\ue014")  # the arrow to the right
        assert browser.execute_script(range_of) == pytest.approx([low + 0.1 * (high - low), high + 0.1 * (high - low)])
        shown.send_keys("0")
        assert browser.execute_script(range_of) == pytest.approx([low, high])
        names = [button.text for button in browser.find_elements("css selector", "#legend button")]
        assert {"torn place", "selected place", "optimised: map"} <= set(names)
        torn = browser.find_elements("css selector", "#legend button")[names.index("torn place")]
        marks = "return document.getElementById('map').data.filter((t) => t.name === 'torn place')[0]"
        assert browser.execute_script(f"{marks}.marker.symbol") == "triangle-up"
        torn.send_keys("\ue007")  # enter
        assert torn.get_attribute("aria-pressed") == "false" and browser.execute_script(f"{marks}.visible") is False
        assert browser.get_log("browser") == []


@pytest.mark.parametrize("least", [-4000.0, -0.3])
def test_the_title_of_the_right_axis_of_a_chart_is_not_cut_where_its_numbers_are_long(least: float) -> None:
    x, y = np.linspace(0.0, 140.0, 50), np.linspace(least, 0.0, 50)
    curves = Curve("speed", canvas.BLUE, over(x, y)), Curve("yaw rate", canvas.ORANGE, over(x, y), beside=True)
    figure, axes = canvas._make_axes(3.0, 0.2)
    canvas._fill(axes, Chart("speed [m/s]", curves, beside="yaw rate [°/s]"))
    box = figure.axes[1].get_tightbbox(FigureCanvasAgg(figure).get_renderer())
    assert box is not None and box.x1 <= figure.bbox.x1
