"""Places of an audit as files and in words, and what a correction does to them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from support.reported import audit_of, judged_revisit, judged_walls, judged_window, swept_walls

from mqslam.auditing.registration import Registration
from mqslam.auditing.spans.sums import SumAudit
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.steps import StepAudit
from mqslam.auditing.windows.windows import Undecided, WindowAudit
from mqslam.config import Config
from mqslam.core import se2
from mqslam.report.crops import make_crop
from mqslam.report.spots import find_worst_spots, list_bad_places, list_unmatched, write_bad_places
from mqslam.report.words import describe_motion, format_change, format_three_digits, format_value

SETTINGS = Config().audit
WALLS = swept_walls()


def windows_of(count: int, unknown: dict[int, Undecided]) -> list[WindowAudit]:
    windows = [judged_window(swept_walls(240), 6 * k, 1.0 + k, (0.02, 0.0, 0.0), False) for k in range(count)]
    return [replace(window, undecided=unknown.get(k)) for k, window in enumerate(windows)]


def test_bad_places_are_those_that_are_torn_and_those_that_are_unknown(tmp_path: Path) -> None:
    audit = judged_walls(WALLS)
    audit.windows[5] = replace(audit.windows[5], undecided=Undecided.APART)
    write_bad_places(tmp_path, list_bad_places(WALLS, audit, SETTINGS))
    rows = list(csv.DictReader((tmp_path / "bad_places.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["kind"], row["torn"]) for row in rows] == [("window", "True"), ("window", "unknown"), ("revisit", "True")]
    assert float(rows[0]["dx"]) == 0.5 and rows[1]["verdict"] == f"undecided: {Undecided.APART}"
    features = json.loads((tmp_path / "bad_places.geojson").read_text())["features"]
    torn = features[2]
    assert torn["geometry"] == {"type": "Point", "coordinates": WALLS.poses[50, :2].tolist()}
    assert torn["properties"]["off_m"] == float(np.hypot(1.25, 0.5))
    assert [feature["properties"]["kind"] for feature in features] == ["window", "window", "revisit"]


def test_a_map_without_a_bad_place_has_files_without_rows(tmp_path: Path) -> None:
    write_bad_places(tmp_path, ())
    assert (tmp_path / "bad_places.csv").read_text().count("\n") == 1
    assert json.loads((tmp_path / "bad_places.geojson").read_text())["features"] == []


def test_successive_windows_that_could_not_be_matched_are_one_stretch() -> None:
    unknown = {2: Undecided.APART, 3: Undecided.APART, 4: Undecided.GAP, 8: Undecided.APART}
    rows = list_unmatched(WALLS, audit_of(windows_of(10, unknown), []))
    assert [(what, time, why) for what, time, _, why, _ in rows] == [
        ("2 windows", "3.0 s to 6.0 s", Undecided.APART),
        ("1 window", "6.0 s to 7.5 s", Undecided.GAP),
        ("1 window", "12.0 s to 13.5 s", Undecided.APART),
    ]
    assert rows[0][2] == "(105, 0) m" and rows[0][4] == "audit.csv, rows whose torn is unknown"


def test_of_many_stretches_the_longest_are_named_and_the_others_counted() -> None:
    unknown = {k: Undecided.APART for k in range(40) if k % 2 == 0 or k == 5}
    rows = list_unmatched(swept_walls(240), audit_of(windows_of(40, unknown), []))
    assert [row[0] for row in rows[:3]] == ["1 window", "1 window", "3 windows"]
    assert len(rows) == 9 and rows[-1][0] == "11 windows more" and rows[-1][-1].startswith("audit.csv")


def test_revisits_that_are_not_sure_say_in_which_file_to_look() -> None:
    revisits = [judged_revisit(16, 43, (0.0, 0.0, 0.0), False), judged_revisit(5, 54, (6.0, 0.0, 0.0), False, sure=False)]
    ((what, time, _, _, look),) = list_unmatched(WALLS, audit_of([], revisits))
    assert what == "1 revisit" and "1.2 s to 13.5 s" in time and look.startswith("revisits.csv")


def test_steps_that_fit_are_not_judged_because_there_are_too_few() -> None:
    fits = Registration(25, 26, np.zeros(3), 1.0, np.zeros(3), np.eye(3), np.zeros(2), 30.0, 0.75, 2.0, 1.0, True, True)
    steps = [StepAudit(fits, 6.0, float("nan")), StepAudit(replace(fits, unrivalled=False), 7.0, float("nan"))]
    rows = list_unmatched(WALLS, replace(audit_of([], []), steps=steps))
    assert [(what, why) for what, _, _, why, _ in rows] == [
        ("1 step", "too few steps show how far off a step usually is"),
        ("1 step", "the scans before and after it do not fit at one place only"),
    ]


def test_a_torn_revisit_is_corrected_by_moving_the_later_pass_alone() -> None:
    spot = find_worst_spots(WALLS, judged_walls(WALLS), SETTINGS)[0]
    assert spot.title.startswith("revisit 2.2 s and 12.5 s")
    before, after = make_crop(WALLS, spot)
    np.testing.assert_array_equal(before[0], after[0])
    moved = after[1][np.argmin(np.hypot(*after[1].T))]
    c, s = np.cos(-0.02), np.sin(-0.02)
    back = (moved - [-1.25, 0.5]) @ np.array([[c, -s], [s, c]])
    assert np.hypot(*(before[1] - back).T).min() < 1e-9


def test_a_torn_window_is_corrected_against_its_middle() -> None:
    worst = find_worst_spots(WALLS, judged_walls(WALLS), SETTINGS)
    spot = next(spot for spot in worst if spot.title.startswith("window 4.5 s"))
    assert [len(sweeps) for sweeps in make_crop(WALLS, spot)] == [6, 6]
    assert "0.50 m ahead, 0.25 m right" in spot.text


def test_the_worst_places_keep_apart_and_fill_up_with_the_largest_inflation() -> None:
    sweeps = swept_walls(120)
    windows = [judged_window(sweeps, 6 * k, float(k), (0.5, 0.0, 0.0), k in (2, 3)) for k in range(20)]
    revisits = [judged_revisit(9, later, (0.1 * later, 0.0, 0.0), True) for later in (100, 102, 104)]
    spots = find_worst_spots(sweeps, audit_of(windows, revisits), SETTINGS)[:5]
    assert [(s.kind, s.sweep) for s in spots[:2]] == [("revisit", 104), ("window", 15)]
    assert [s.torn for s in spots] == [True, True, False, False, False]
    begins = [s.sweep for s in spots if s.kind == "window"]
    assert begins[1] == 117
    assert np.diff(np.sort(sweeps.travelled[begins])).min() > 50.0


def test_jumps_and_spans_are_among_the_worst_places_with_what_would_mend_them() -> None:
    between = se2.between(WALLS.poses[20], WALLS.poses[26])
    jumped = Registration(
        25, 26, between, 1.0, np.array([-2.0, 0.5, 0.0]), np.eye(3), np.zeros(2), 30.0, 0.75, 2.0, 1.0, True, True
    )
    bent = replace(jumped, earlier=20, offset=np.array([0.0, 0.3, 0.01]))
    jump = StepAudit(jumped, 6.5, 1e-9)
    span = SpanAudit(bent, 5.0, 6.5, bent.offset, np.diag([0.01, 0.01, 1e-4]), 1e-9, True)
    whole = replace(span, t0=9.0, torn=False)
    found = find_worst_spots(WALLS, replace(audit_of([], []), jumps=[jump], spans=[span, whole]), SETTINGS)
    assert [(spot.kind, spot.time) for spot in found] == [("jump", "at 6.5 s"), ("span", "5.0 s to 6.5 s")]
    assert found[0].text == (
        "What was seen after the jump fits if it is moved 2.00 m back, 0.50 m left, which moves its points by 2.06 m; "
        "75 % of its points then lie on what was seen before."
    )
    assert "The end of the span fits 0.30 m from where the trajectory has it, moved 0.30 m left" in found[1].text
    assert found[1].text.endswith("Inflation 10.")
    before, after = make_crop(WALLS, found[0])
    assert sum(map(len, before)) and sum(map(len, after))
    np.testing.assert_array_equal(before[0], after[0])
    assert not np.array_equal(before[1], after[1])


def test_a_torn_sum_of_spans_is_a_bad_place_with_its_begin_end_and_size(tmp_path: Path) -> None:
    torn = SumAudit(8, 20, 2.0, 5.0, 60.0, np.array([0.3, -0.4, 0.01]), np.diag([0.01, 0.01, 1e-4]), 1e-9, True)
    fine = replace(torn, earlier=32, later=44, t0=8.0, t1=11.0, torn=False)
    audit = replace(audit_of([], []), sums=[torn, fine])
    (spot,) = find_worst_spots(WALLS, audit, SETTINGS)
    assert spot.cells == ("sum", "2.0 s to 5.0 s", "(100, 0) m", "0.50 m", *spot.cells[4:6], "torn")
    assert spot.text.startswith("The end of these 60 m of path fits 0.50 m from where the trajectory has it, moved 0.30 m ")
    write_bad_places(tmp_path, list_bad_places(WALLS, audit, SETTINGS))
    (row,) = csv.DictReader((tmp_path / "bad_places.csv").read_text(encoding="utf-8").splitlines())
    assert [row["kind"], *map(float, (row["t0"], row["t1"], row["off_m"]))] == ["sum", 2.0, 5.0, 0.5]
    before, after = make_crop(WALLS, spot)
    assert len(before) == len(after) == 2


def test_directions_are_said_as_a_driver_would() -> None:
    assert describe_motion((1.5, -0.02, 0.01)) == "1.50 m ahead, 20 mm right, turned 0.57° left"
    assert describe_motion((0.0, 0.0, 0.0)) == "nowhere"


def test_no_figure_is_a_negative_zero() -> None:
    assert (format_value(-0.0, " m"), format_three_digits(-0.0)) == ("0 m", "0")
    assert format_change(0.2, 0.19999) == "+0.0 %" and format_change(0.2, 0.19) == "−5.0 %"
