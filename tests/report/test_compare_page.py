from __future__ import annotations

import html
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from selenium.webdriver.support.ui import WebDriverWait
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

from mqslam.comparison.judgement import JudgedRow, Place, compare_pairs
from mqslam.comparison.rows import Row
from mqslam.core import se2
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import Evaluation
from mqslam.report.compare_page import write_compare_report
from mqslam.report.figures.compare_figures import draw_overlay, smooth_inflation
from mqslam.report.inputs.compare_report import CompareReport, rank_rows

START_US = 1_600_000_000_000_000


def bow(turn: float, begin: tuple[float, float, float] = (0.0, 0.0, 0.0), count: int = 200) -> Trajectory:
    """Returns a path of 1 m steps that turns by the same angle [rad] at each, from some pose."""
    steps = se2.exp(np.tile([1.0, 0.0, turn], (count, 1)), np.arange(count))
    return Trajectory(START_US + 250_000 * np.arange(count), se2.compose(np.array(begin), steps))


def judged(name: str, trajectory: Trajectory) -> JudgedRow:
    rng = np.random.default_rng(len(name))
    row = Row(name, None, trajectory, trajectory)
    crops = tuple(rng.uniform(-50.0, 50.0, (300, 2)) for _ in range(2))
    points = rng.uniform(-50.0, 50.0, (500, 2))
    drawn = PointMap(points, rng.uniform(0.0, 15.0, 500), np.full(500, 80.0), rng.random(500), np.ones(500, bool))
    return JudgedRow(row, 0.6, 0.8, judged_walls(swept_walls()), None, None, None, crops, drawn)


def a_report(truth: Trajectory | None) -> CompareReport:
    rows = (judged("psi", bow(0.01)), judged("_kiss_$icp$ <icp>", bow(0.012, (30.0, 20.0, 1.0))))
    failed = Row("odometry", failure="no odometry; give <FILE>")
    return CompareReport(
        title="run <01>",
        summary={
            "mqslam_version": "9.8.7",
            "dataset": {"format": "mulran", "path": "/data/<run>"},
            "threshold": 16.3,
            "best": {"rows": ["psi"], "decided_by": "drift", "sentence": "psi is best, <b>and so on</b>."},
        },
        rows=rows,
        failed=(failed,),
        places=(Place(6, 12, 1.5, 3.0, 1.25), Place(30, 36, 7.5, 9.0, 0.04)),
        stations=(),
        start_us=START_US,
        agreement=tuple(compare_pairs([row.row for row in rows])),
        ground_truth=truth,
        table=(
            ("", "drift [%]", "inflation"),
            ("psi", "0.5", "2.4"),
            ("_kiss_$icp$ <icp>", "1.1", "9"),
            ("odometry", "could not run", ""),
        ),
        marked=frozenset({(1, 1), (1, 2), (2, 2)}),
        warnings=("odometry <img src=x> could not run",),
        settings_yaml="audit:\n  window: 6  # <sweeps>\n",
        ranks=(("_kiss_$icp$ <icp>",), ("psi",)),
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compare") / "report.html"
    write_compare_report(path, a_report(bow(0.01, (500.0, 300.0, 2.0))))
    return path


def test_the_page_needs_nothing_from_outside(written: Path) -> None:
    assert_alone(written)


def test_what_is_written_by_others_is_escaped(written: Path) -> None:
    text = page_of(written).text
    for shown in ("run <01>", "<img src=x>", "_kiss_$icp$ <icp>", "give <FILE>", "/data/<run>", "# <sweeps>"):
        assert shown in text
    assert not re.search(r"<(img src=x|icp|run|FILE|sweeps|01)>", written.read_text(encoding="utf-8"))


def test_warnings_come_first_and_the_table_is_the_terminals(written: Path) -> None:
    text = page_of(written).text
    assert text.index("<img src=x>") < text.index("drift [%]\ninflation\npsi\n0.5\n2.4") < text.index("running median")
    assert 'colspan="2">could not run</td>' in written.read_text(encoding="utf-8")


def test_the_sentence_that_names_the_best_row_stands_before_the_table(written: Path) -> None:
    text = page_of(written).text
    assert text.index("psi is best, <b>and so on</b>.") < text.index("drift [%]\n")


def test_the_best_values_are_marked_and_no_others(written: Path) -> None:
    text = written.read_text(encoding="utf-8")
    by_row, by_column = ["0.5", "2.4", "9"], ["0.5", "2.4", "9"]
    assert re.findall(r'<td class="best" [^>]*>(.*?)</td>', text) == by_row + by_column
    assert re.findall(r"<td data-label=[^>]*>(1\.1)</td>", text) == ["1.1"] * 2


def test_cards_rank_the_rows_and_mark_their_best_values(written: Path) -> None:
    cards = re.findall(r'<span class="rank">(\d+)</span><h3>(.*?)</h3>', written.read_text(encoding="utf-8"))
    assert [(rank, html.unescape(name)) for rank, name in cards] == [("1", "_kiss_$icp$ <icp>"), ("2", "psi")]
    assert re.findall(r'<dd class="best">(.*?)</dd>', written.read_text(encoding="utf-8")) == ["0.5"]


def test_rows_that_cannot_be_told_apart_share_a_rank() -> None:
    rows = [judged("psi", bow(0.01)), judged("icp", bow(0.01)), judged("odometry", bow(0.01))]
    ate = Evaluation(0.1, 0.5, 0.1, 0.0, 0.0, 0.0, 0.0)
    errors = [ate, ate, replace(ate, drift_percent=2.0)]
    assert rank_rows([replace(r, after=e) for r, e in zip(rows, errors, strict=True)]) == (
        ("psi", "icp"),
        ("odometry",),
    )


def test_inflation_is_a_running_median_that_one_window_does_not_move() -> None:
    windows = list(judged_walls(swept_walls()).windows)
    times, smooth = smooth_inflation(windows)
    assert max(w.bend.inflation for w in windows) == 120.0 and smooth.max() < 20.0
    assert times.tolist() == [0.5 * (w.t0 + w.t1) for w in windows]


def test_every_place_shows_every_row_on_one_extent(written: Path) -> None:
    images = page_of(written).images
    shown = [name for name in images if " apart, " in name]
    assert [name.split(" apart, ")[1] for name in shown] == ["psi", "_kiss_$icp$ <icp>"] * 2
    assert "1.5 s to 3.0 s, up to 1.25 m apart" in shown[0]
    assert "up to 40 mm apart" in shown[2]
    assert len({Image.open(io.BytesIO(images[name])).size for name in shown}) == 1


def test_agreement_and_failures_are_listed(written: Path) -> None:
    text = page_of(written).text
    assert re.search(r"psi – _kiss_\$icp\$ <icp>\n\d+\.\d{3} m\n\d+\.\d{3} %", text)
    assert "Could not run\nodometry\nno odometry; give <FILE>" in text


def test_trajectories_of_other_frames_are_laid_on_the_truth() -> None:
    truth = bow(0.01, (500.0, 300.0, 2.0))
    rows = [judged("alone", bow(0.01, (0.0, 0.0, -1.0)))]
    assert draw_overlay(rows, truth) == draw_overlay([judged("alone", bow(0.01, (40.0, 0.0, 0.5)))], truth)


def test_without_truth_all_start_from_one_pose() -> None:
    rows = [judged("one", bow(0.01)), judged("two", bow(0.01, (40.0, 10.0, 0.5)))]
    moved = [judged("one", bow(0.01)), judged("two", bow(0.01))]
    assert draw_overlay(rows, None) == draw_overlay(moved, None)


def test_the_overlay_is_opaque_by_itself_and_transparent_in_a_page() -> None:
    one = [judged("one", bow(0.01))]
    corners = [
        np.asarray(Image.open(io.BytesIO(draw_overlay(one, None, opaque=opaque))).convert("RGBA"))[2, 2]
        for opaque in (True, False)
    ]
    assert corners[0].tolist() == [255, 255, 255, 255]
    assert corners[1][3] == 0


def test_a_part_that_cannot_be_drawn_costs_no_other_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mqslam.report.compare_page.draw_place", lambda *_: 1 / 0)
    failures = write_compare_report(tmp_path / "partial.html", a_report(None))
    assert len(failures) == 1 and failures[0].startswith("where the rows differ could not be made (ZeroDivisionError")
    page = page_of(tmp_path / "partial.html")
    assert page.text.count(failures[0]) == 2 and "Agreement" in page.text and "Trajectories" in page.images


def test_a_comparison_of_one_row_without_truth_still_has_a_report(tmp_path: Path) -> None:
    report = a_report(None)
    alone = replace(report, rows=report.rows[:1], failed=(), places=(), agreement=(), summary={"best": None}, warnings=())
    write_compare_report(tmp_path / "alone.html", alone)
    page = page_of(tmp_path / "alone.html")
    assert set(page.images) == {"Trajectories"}
    assert set(page.drawings) == {"Inflation of the windows", "Offset of the revisits"}
    assert "Could not run" not in page.text and "is best" not in page.text
    assert "all starting from one pose" in page.text


def test_many_rows_with_long_names_are_all_in_the_legend(tmp_path: Path) -> None:
    report = a_report(None)
    rows = tuple(judged(f"a front end with a long name, number {k}", bow(0.001 * k)) for k in range(8))
    write_compare_report(tmp_path / "many.html", replace(report, rows=rows))
    few, many = (Image.open(io.BytesIO(draw_overlay(r, None))).size for r in (rows[:2], rows))
    assert many[0] == few[0]
    assert many[1] > few[1]


def test_the_same_comparison_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    write_compare_report(tmp_path / "again.html", a_report(bow(0.01, (500.0, 300.0, 2.0))))
    assert (tmp_path / "again.html").read_bytes() == written.read_bytes()


@pytest.mark.slow
def test_a_click_on_a_window_shows_it_under_every_row(written: Path) -> None:
    with chromium() as browser:
        opened(browser, written)
        assert browser.find_element("tag name", "h1").text == "run <01>"
        before = browser.find_element("id", "place").text
        click_curve(browser, a_report(None).rows[0].row.name, 6)
        WebDriverWait(browser, PATIENCE_S).until(lambda b: b.find_element("id", "place").text != before)
        views = browser.execute_script("return document.getElementById('crop').layout.annotations.map((a) => a.text)")
        assert [html.unescape(name) for name in views] == [row.row.name for row in a_report(None).rows]
        assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault(written: Path, scheme: str, width: int) -> None:
    assert find_faults(written, scheme, width) == []
