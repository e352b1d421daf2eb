"""What the page of a comparison shows besides what all pages have."""

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
from support.pages import ROWS, START_US, a_comparison, bow, judged_row, text_of, write_comparison
from support.reported import (
    PATIENCE_S,
    audit_of,
    chromium,
    click_curve,
    judged_walls,
    judged_window,
    opened,
    page_of,
    swept_walls,
)

from mqslam.auditing.windows.windows import Undecided
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.comparison.rows import Row
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.evaluation import Evaluation
from mqslam.report.compare_page import (
    draw_difference,
    draw_overlay,
    find_close_view,
    rank_rows,
    select_moving_places,
    select_moving_windows,
    smooth_inflation,
)


def test_the_table_is_the_terminals_with_ranks(pages: dict[str, Path]) -> None:
    assert "rank\ndrift [%]\nverdict\ninflation\npsi\n1\n0.5\npass\n2.4\n_kiss_$icp$ <icp>\n1\n1.1\nfail" in text_of(
        pages["compare"]
    )
    assert 'colspan="4">failed</td>' in (pages["compare"] / "report.html").read_text(encoding="utf-8")


def test_notes_explain_the_ranks_the_marks_and_which_row_lacks_scans(pages: dict[str, Path]) -> None:
    text = text_of(pages["compare"])
    criteria = "drift, ATE, share of torn windows, share of torn revisits and verdict decide the ranks, in this order"
    assert f"Rank 1 is the best row: {criteria}, as far as they are known." in text
    assert "Every row is judged alike, against ground truth and without it. Bold and green is the best value; ↓ less" in text
    assert "Of 60 scans, _kiss_$icp$ <icp> covers 50; every row is judged on the 50 that all rows cover." in text


def test_the_best_values_are_marked_and_no_others(pages: dict[str, Path]) -> None:
    text = (pages["compare"] / "report.html").read_text(encoding="utf-8")
    assert re.findall(r'<td class="best" [^>]*>(.*?)</td>', text) == ["0.5", "2.4", "9"]
    assert re.findall(r"<td data-label=[^>]*>(1\.1)</td>", text) == ["1.1"]


def test_rows_that_cannot_be_told_apart_share_a_rank() -> None:
    rows = [judged_row("odometry", bow(0.01)), judged_row("psi", bow(0.01)), judged_row("icp", bow(0.01))]
    ate = Evaluation(0.1, 0.5, 0.1, 0.0, 0.0, 0.0, 0.0)
    errors = [replace(ate, drift_percent=2.0), ate, ate]
    ranks = rank_rows([replace(r, after=e) for r, e in zip(rows, errors, strict=True)])
    assert ranks == {"psi": 1, "icp": 1, "odometry": 3}


def test_inflation_is_a_running_median_that_one_window_does_not_move() -> None:
    windows = list(judged_walls(swept_walls()).windows)
    times, smooth = smooth_inflation(windows).T
    assert max(w.bend.inflation for w in windows) == 120.0 and smooth.max() < 20.0
    assert times.tolist() == [0.5 * (w.t0 + w.t1) for w in windows]


def test_the_rows_stand_in_one_picture_where_they_are_the_farthest_apart(pages: dict[str, Path]) -> None:
    images = page_of(pages["compare"] / "report.html").images
    assert set(images) == {"All rows in one map", "Trajectories"}
    drawn = draw_difference([judged_row("one", bow(0.0)), judged_row("two", bow(0.001))], None)
    assert drawn is not None
    _, apart_m, time_s = drawn
    assert apart_m == pytest.approx(19.9, abs=0.3) and time_s == pytest.approx(49.75)
    assert draw_difference([judged_row("one", bow(0.0))], None) is None


@pytest.mark.parametrize(
    ("side_m", "apart_m", "expected_m"),
    [
        (2000.0, 0.5, 60.0),
        (2000.0, 5.0, 100.0),
        (2000.0, 90.0, 300.0),
        (40.0, 0.1, 10.6),
        (40.0, 1.0, 20.0),
        (40.0, 13.0, 42.4),
    ],
)
def test_the_picture_of_the_difference_fits_streets_and_rooms(side_m: float, apart_m: float, expected_m: float) -> None:
    edge = np.linspace(0.0, side_m, 500)
    view = find_close_view(np.array([3.0, 4.0]), apart_m, [np.column_stack([edge, edge])])
    assert view.x1 - view.x0 == pytest.approx(expected_m, rel=0.02) == view.y1 - view.y0
    assert (view.x0 + view.x1, view.y0 + view.y1) == pytest.approx((6.0, 8.0))


def test_a_sceptic_reads_who_judges_and_by_what(pages: dict[str, Path], tmp_path: Path) -> None:
    text = text_of(pages["compare"])
    for shown in ("The same audit for every row", "60 scans", "It uses no ground truth", "bends of 5 cm and more"):
        assert shown in text, shown
    assert f"Why is the verdict on psi {ROWS[0].audit.verdict.status}?" in text
    audit = replace(ROWS[0].audit, tests={"windows": []})
    write_comparison(tmp_path, a_comparison((replace(ROWS[0], audit=audit), ROWS[1])))
    assert "By what?\nwindows: the map of six scans with its best map under a correction of the speed\n" in text_of(tmp_path)


def test_agreement_and_failures_are_listed(pages: dict[str, Path]) -> None:
    text = text_of(pages["compare"])
    assert re.search(r"psi – _kiss_\$icp\$ <icp>\n\d+\.\d{3} m, \d+\.\d{3} %", text)
    assert "Failed\nodometry\nno odometry; give <FILE>" in text


def test_trajectories_of_other_frames_are_laid_on_the_truth() -> None:
    truth = bow(0.01, (500.0, 300.0, 2.0))
    rows = [judged_row("alone", bow(0.01, (0.0, 0.0, -1.0)))]
    assert draw_overlay(rows, truth) == draw_overlay([judged_row("alone", bow(0.01, (40.0, 0.0, 0.5)))], truth)


def test_without_truth_all_start_from_one_pose() -> None:
    rows = [judged_row("one", bow(0.01)), judged_row("two", bow(0.01, (40.0, 10.0, 0.5)))]
    moved = [judged_row("one", bow(0.01)), judged_row("two", bow(0.01))]
    assert draw_overlay(rows, None) == draw_overlay(moved, None)


def test_the_overlay_is_opaque_by_itself_and_transparent_in_a_page() -> None:
    pictures = [draw_overlay([judged_row("one", bow(0.01))], None, opaque=opaque) for opaque in (True, False)]
    corners = [np.asarray(Image.open(io.BytesIO(picture)).convert("RGBA"))[2, 2] for picture in pictures]
    assert corners[0].tolist() == [255, 255, 255, 255]
    assert corners[1][3] == 0


def test_a_comparison_of_one_row_without_truth_still_has_a_report(tmp_path: Path) -> None:
    alone = a_comparison(ROWS[:1], rows=(ROWS[0].row,), places=(), agreement=())
    assert write_comparison(tmp_path, alone, {"best": None, "dataset": {}, "rows": []}) == []
    page = page_of(tmp_path / "report.html")
    assert set(page.images) == {"Trajectories"}
    assert set(page.drawings) == {"Inflation of the windows", "Offset of the revisits"}
    assert "Failed" not in page.text and "is best" not in page.text
    assert "all moved to one pose" in page.text


def test_many_rows_with_long_names_are_all_in_the_legend() -> None:
    rows = tuple(judged_row(f"a front end with a long name, number {k}", bow(0.001 * k)) for k in range(8))
    few, many = (Image.open(io.BytesIO(draw_overlay(some, None))).size for some in (rows[:2], rows))
    assert many[0] == few[0]
    assert many[1] > few[1]


def test_windows_and_places_of_a_standstill_are_left_out() -> None:
    seconds = np.arange(0.0, 15.25, 0.25)
    stamps = START_US + np.round(1e6 * seconds).astype(np.int64)
    track = Trajectory(stamps, np.c_[np.maximum(seconds - 6.0, 0.0), np.zeros((len(seconds), 2))])
    audit = audit_of([judged_window(swept_walls(), 6 * k, 1.0 + k, (0.02, 0.0, 0.0), False) for k in range(10)], [])
    row = JudgedRow(Row("psi", None, track, track), None, None, audit, None, None, None, (), PointMap.empty())
    (windows,) = select_moving_windows([row], START_US)
    assert [window.t0 for window in windows] == [6.0, 7.5, 9.0, 10.5, 12.0, 13.5]
    audit.windows[5] = replace(audit.windows[5], undecided=Undecided.APART)  # its inflation means nothing
    assert [window.t0 for window in select_moving_windows([row], START_US)[0]] == [6.0, 9.0, 10.5, 12.0, 13.5]
    places = [Place(0, 6, 1.5, 3.0, 0.0), Place(24, 30, 6.0, 7.5, 0.1)]
    assert select_moving_places([row], places, START_US) == [1]
    turning = Trajectory(stamps, np.c_[np.zeros((len(seconds), 2)), 0.1 * seconds])
    assert select_moving_places([replace(row, row=Row("psi", None, turning, turning))], places, START_US) == [0, 1]


@pytest.mark.slow
def test_a_click_on_a_window_shows_it_under_every_row(pages: dict[str, Path]) -> None:
    with chromium() as browser:
        opened(browser, pages["compare"] / "report.html")
        before = browser.find_element("id", "place").text
        click_curve(browser, ROWS[0].row.name, 6)
        WebDriverWait(browser, PATIENCE_S).until(lambda b: b.find_element("id", "place").text != before)
        views = browser.execute_script("return document.getElementById('crop').layout.annotations.map((a) => a.text)")
        assert [html.unescape(name) for name in views] == [row.row.name for row in ROWS]
        assert browser.get_log("browser") == []
