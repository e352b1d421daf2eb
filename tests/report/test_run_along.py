"""The charts of a run along its path, the place that a map which passes opens on, and the size of its page."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.reported import chromium, judged_walls, opened, page_of, swept_walls

from mqslam.backend.marginals import PoseCovariances
from mqslam.config import AuditConfig
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.report import Report, ScanScores, write_report
from mqslam.report.content import Figure
from mqslam.report.sections.run_along import chart_path

START_US = 1_600_000_000_000_000
SPEED_MPS = 5.0


def along(scale: float, scans: int = 240) -> Trajectory:
    x = scale * SPEED_MPS * 0.25 * np.arange(scans)
    return Trajectory(START_US + 250_000 * np.arange(scans), np.c_[x, np.zeros(scans), np.zeros(scans)])


def a_report(status: str = "pass") -> Report:
    rng = np.random.default_rng(3)
    points = rng.uniform(0.0, 300.0, (3000, 2))
    drawn = PointMap(points, np.linspace(0.0, 60.0, 3000), np.full(3000, 80.0), rng.random(3000), np.ones(3000, bool))
    nothing = np.empty(0)
    used = {"moved_m": 0.25, "turned_rad": np.pi / 180.0, "bias_radps": np.pi / 90.0}
    summary: dict[str, Any] = {
        "verdict": {"status": status, "reasons": []},
        "sensors": {"gyroscope": used, "gnss": None, "chirps": {"moved_m": None}},
        "evaluation": {"rpe_w_rms": np.pi / 60.0},
    }
    return Report(
        title="drive",
        summary=summary,
        odometry=along(1.05),
        optimised=along(1.0),
        ground_truth=along(1.0),
        map_odometry=drawn,
        map_optimised=drawn,
        scores=ScanScores(nothing, nothing, nothing, nothing, np.empty(0, np.int64), nothing, ()),
        before="odometry",
        checks=tuple(judged_walls(swept_walls()).windows),
        settings=AuditConfig(),
        loops=np.empty((0, 2), np.int64),
        covariances=PoseCovariances(np.array([0, 120, 239]), np.tile(np.diag([0.04, 0.09, 1e-4]), (3, 1, 1))),
        warnings=(),
        settings_yaml="",
    )


def charts_of(report: Report) -> dict[str, Figure]:
    section = chart_path(report)
    assert section is not None
    return {figure.heading: figure for figure in section.figures}


def words_of(figure: Figure) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", figure.picture.decode())


def scene_of(report: Report, path: Path) -> dict[str, Any]:
    assert write_report(path, report) == []
    scene = re.search(r'id="scene">(.*?)</script>', path.read_text(encoding="utf-8"), re.DOTALL)
    assert scene is not None
    return json.loads(scene[1])


def test_all_that_is_looked_for_along_a_path_is_drawn_and_its_words_stay_words() -> None:
    charts = charts_of(a_report())
    assert list(charts) == [
        "Error over distance",
        "Drift by segment length",
        "Correction over distance",
        "Speed and yaw rate",
        "Covariance along the path",
        "Contribution of each sensor",
    ]
    assert {"odometry: translation", "optimised: rotation"} <= set(words_of(charts["Drift by segment length"]))
    assert {"along", "across", "heading"} <= set(words_of(charts["Covariance along the path"]))
    told = " ".join(words_of(charts["Contribution of each sensor"]))
    assert "gyroscope: 0.25 m, turns the end by +1°" in told and "GNSS" not in told and "chirps" not in told
    assert "100 m to 200 m" in charts["Drift by segment length"].caption


def test_without_truth_sensors_and_covariances_what_is_known_remains() -> None:
    bare = replace(a_report(), ground_truth=None, summary={}, covariances=PoseCovariances.unknown("singular"))
    assert list(charts_of(bare)) == ["Correction over distance", "Speed and yaw rate"]
    assert chart_path(replace(bare, optimised=along(1.0, 1))) is None


def test_the_same_chart_has_the_same_bytes() -> None:
    first, again = charts_of(a_report()), charts_of(a_report())
    assert all(first[name].picture == again[name].picture for name in first)


def test_angles_are_in_degrees(tmp_path: Path) -> None:
    write_report(tmp_path / "r.html", a_report())
    text = re.sub(r"\n+", "\n", page_of(tmp_path / "r.html").text)
    assert "bias\n2 °/s" in text and "turns its end by\n1 °" in text and "yaw rate error, RMS\n3 °/s" in text
    assert " rad" not in text[text.index("Numbers") : text.index("Settings")]


@pytest.mark.parametrize("status", ["pass", "fail"])
def test_a_map_that_passes_opens_in_grey_on_its_largest_correction(tmp_path: Path, status: str) -> None:
    scene = scene_of(a_report(status), tmp_path / "r.html")
    assert scene["places"][scene["first"]]["kind"] == "torn" and scene["calm"] is (status == "pass")
    assert scene["first_is"] == ("Largest correction (too few are torn to count)" if scene["calm"] else "")
    fine = replace(a_report(status), checks=tuple(w for w in a_report().checks if not w.torn))
    whole = scene_of(fine, tmp_path / "w.html")
    assert whole["first_is"] == ("Largest correction (harmless)" if whole["calm"] else "")
    inflation = [window.bend.inflation for window in fine.checks]
    assert whole["first"] == int(np.argmax(inflation))


def test_a_line_stands_above_the_map_and_the_rest_unfolds(tmp_path: Path) -> None:
    write_report(tmp_path / "r.html", a_report())
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    head = page[page.index('<section class="live">') : page.index('<div id="legend"')]
    before, folded = head.split('<details class="how"><summary>How to read this</summary>')
    assert before.count("<p") == 1 and "Click a dot" in before and "is torn where its inflation" in folded


@pytest.mark.slow
def test_it_prints_on_a4(tmp_path: Path) -> None:
    write_report(tmp_path / "r.html", a_report())
    with chromium() as browser:
        opened(browser, tmp_path / "r.html")
        printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", base64.b64decode(printed))
    assert boxes and all((round(float(w)), round(float(h))) == (595, 842) for w, h in boxes)


@pytest.mark.slow
def test_the_keyboard_moves_the_map_and_its_legend_hides_what_it_names(tmp_path: Path) -> None:
    write_report(tmp_path / "r.html", a_report())
    range_of = "return document.getElementById('map')._fullLayout.xaxis.range.map(Number)"
    with chromium() as browser:
        opened(browser, tmp_path / "r.html")
        assert browser.find_element("id", "place").text.startswith("Largest correction (too few")
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
