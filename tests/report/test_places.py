"""Places of an audit as files and in words, and those of a comparison at which the radar moves."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from support.reported import audit_of, judged_revisit, judged_walls, judged_window, swept_walls

from mqslam.auditing.windows.windows import Undecided, WindowAudit
from mqslam.comparison.judgement import JudgedRow, Place
from mqslam.comparison.rows import Row
from mqslam.config import Config
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.report.compare_page import select_moving_places, select_moving_windows
from mqslam.report.places.bad_places import list_bad_places, write_bad_places
from mqslam.report.sections.audit_places import find_unmatched

START_US = 1_600_000_000_000_000


def windows_of(count: int, unknown: dict[int, Undecided]) -> list[WindowAudit]:
    windows = [judged_window(swept_walls(), 6 * k, 1.0 + k, (0.02, 0.0, 0.0), False) for k in range(count)]
    return [replace(window, undecided=unknown.get(k)) for k, window in enumerate(windows)]


def test_bad_places_are_those_that_are_torn_and_those_that_are_unknown(tmp_path: Path) -> None:
    sweeps = swept_walls()
    audit = judged_walls(sweeps)
    audit.windows[5] = replace(audit.windows[5], undecided=Undecided.APART)
    spots = list_bad_places(sweeps, audit, Config().audit)
    write_bad_places(tmp_path, spots)
    rows = list(csv.DictReader((tmp_path / "bad_places.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["kind"], row["torn"]) for row in rows] == [("window", "True"), ("window", "unknown"), ("revisit", "True")]
    assert float(rows[0]["dx"]) == 0.5 and rows[1]["verdict"] == f"undecided: {Undecided.APART}"
    features = json.loads((tmp_path / "bad_places.geojson").read_text())["features"]
    torn = features[2]
    assert torn["geometry"] == {"type": "Point", "coordinates": sweeps.poses[50, :2].tolist()}
    assert torn["properties"]["off_m"] == float(np.hypot(1.25, 0.5))
    assert [feature["properties"]["kind"] for feature in features] == ["window", "window", "revisit"]


def test_a_map_without_a_bad_place_has_files_without_rows(tmp_path: Path) -> None:
    write_bad_places(tmp_path, ())
    assert (tmp_path / "bad_places.csv").read_text().count("\n") == 1
    assert json.loads((tmp_path / "bad_places.geojson").read_text())["features"] == []


def test_successive_windows_that_could_not_be_matched_are_one_stretch() -> None:
    unknown = {2: Undecided.APART, 3: Undecided.APART, 4: Undecided.GAP, 8: Undecided.APART}
    found = find_unmatched(swept_walls(), audit_of(windows_of(10, unknown), []))
    assert [(place.what, place.time, place.why) for place in found] == [
        ("2 windows", "3.0 s to 6.0 s", Undecided.APART),
        ("1 window", "6.0 s to 7.5 s", Undecided.GAP),
        ("1 window", "12.0 s to 13.5 s", Undecided.APART),
    ]
    assert found[0].where == "(105, 0) m" and found[0].look == "audit.csv, rows whose torn is unknown"


def test_of_many_stretches_the_longest_are_named_and_the_others_counted() -> None:
    sweeps = swept_walls(240)
    windows = [judged_window(sweeps, 6 * k, 1.0, (0.02, 0.0, 0.0), False) for k in range(40)]
    apart = [replace(w, undecided=Undecided.APART) if k % 2 == 0 or k == 5 else w for k, w in enumerate(windows)]
    found = find_unmatched(sweeps, audit_of(apart, []))
    assert [place.what for place in found[:3]] == ["1 window", "1 window", "3 windows"]
    assert len(found) == 9 and found[-1].what == "11 windows more" and found[-1].look.startswith("audit.csv")


def test_revisits_that_are_not_sure_say_in_which_file_to_look() -> None:
    revisits = [judged_revisit(16, 43, (0.0, 0.0, 0.0), False), judged_revisit(5, 54, (6.0, 0.0, 0.0), False, sure=False)]
    (found,) = find_unmatched(swept_walls(), audit_of([], revisits))
    assert found.what == "1 revisit" and "1.2 s to 13.5 s" in found.time and found.look.startswith("revisits.csv")


def test_windows_and_places_of_a_standstill_are_left_out() -> None:
    seconds = np.arange(0.0, 15.25, 0.25)
    ahead = np.maximum(seconds - 6.0, 0.0)
    track = Trajectory(
        START_US + np.round(1e6 * seconds).astype(np.int64), np.c_[ahead, np.zeros_like(ahead), np.zeros_like(ahead)]
    )
    audit = audit_of(windows_of(10, {}), [])
    nothing = PointMap.empty()
    row = JudgedRow(Row("psi", None, track, track), None, None, audit, None, None, None, (), nothing)
    (windows,) = select_moving_windows([row], START_US)
    assert [window.t0 for window in windows] == [6.0, 7.5, 9.0, 10.5, 12.0, 13.5]
    places = [Place(0, 6, 1.5, 3.0, 0.0), Place(24, 30, 6.0, 7.5, 0.1)]
    assert select_moving_places([row], places, START_US) == (1,)
    turning = Trajectory(track.stamps_us, np.c_[np.zeros((len(seconds), 2)), 0.1 * seconds])
    turned = replace(row, row=Row("psi", None, turning, turning))
    assert select_moving_places([turned], places, START_US) == (0, 1)
