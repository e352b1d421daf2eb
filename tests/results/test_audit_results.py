"""What an audit writes where nothing was decided: `unknown` and null, never `False`."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from support.reported import judged_walls, swept_walls

from mqslam.auditing.findings import judge_windows
from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import Undecided, state_p_values
from mqslam.cli.remedies import name_options
from mqslam.config import Config
from mqslam.errors import Remedy
from mqslam.results.audit_results import summarise, write_audit

CONFIG = Config()


def written(folder: Path, audit: Audit, sweeps: Sweeps) -> tuple[dict[str, Any], list[str], list[str]]:
    """Writes an audit, and returns its JSON and what its tables say of windows and revisits being torn."""
    folder.mkdir()
    write_audit(
        folder,
        CONFIG,
        summarise(audit, sweeps, CONFIG, {"path": "drive", "format": "native"}, "given"),
    )
    tables = []
    for name in ("audit.csv", "revisits.csv"):
        tables.append([row["torn"] for row in csv.DictReader((folder / name).read_text().splitlines())])
    return json.loads((folder / "audit.json").read_text()), *tables


def test_what_was_not_decided_is_unknown(tmp_path: Path) -> None:
    sweeps = swept_walls()
    audit = judged_walls(sweeps)
    audit.windows[5] = replace(audit.windows[5], undecided=Undecided.GAP)
    content, windows, revisits = written(tmp_path / "a", audit, sweeps)
    assert windows == ["False", "False", "False", "True", "False", "unknown", "False", "False", "False", "False"]
    assert revisits == ["False", "True", "unknown"]  # the last one is not sure
    assert [row["torn"] for row in content["per_window"]][3:6] == [True, False, None]
    assert [row["torn"] for row in content["per_revisit"]] == [False, True, None]
    assert content["windows"]["count"] == 10 and content["windows"]["undecided"] == 1
    assert content["per_window"][5]["undecided"] == Undecided.GAP and content["per_window"][4]["undecided"] is None


def test_p_values_are_empty_where_nothing_was_judged(tmp_path: Path) -> None:
    sweeps = swept_walls()
    audit = judged_walls(sweeps)
    audit.windows[5] = replace(audit.windows[5], undecided=Undecided.APART)
    audit = replace(audit, windows=state_p_values(audit.windows))
    audit.revisits[1] = replace(audit.revisits[1], p_value=1e-7, stated_covariance=np.diag([0.04, 0.01, 1e-4]))
    content, _, _ = written(tmp_path / "a", audit, sweeps)
    told = [row["p_value"] for row in content["per_window"]]
    assert told[5] is None and told[3] == min(p for p in told if p is not None)
    expected = [min(9.0 * chi2.sf(w.bend.inflation, 3), 1.0) for w in audit.windows]  # nine were decided
    assert told[:5] == pytest.approx(expected[:5])
    (finding,) = judge_windows(audit.windows, len(sweeps))
    assert finding.p_value == told[3]
    rows = list(csv.DictReader((tmp_path / "a" / "revisits.csv").read_text().splitlines()))
    assert [row["p_value"] for row in rows] == ["", "1e-07", ""]
    assert [row["claimed_sigma_x"] for row in rows] == ["", "0.2", ""]
    assert list(csv.DictReader((tmp_path / "a" / "audit.csv").read_text().splitlines()))[5]["p_value"] == ""


def test_without_a_trajectory_there_is_no_path_and_no_revisit(tmp_path: Path) -> None:
    sweeps = swept_walls()
    content, _, _ = written(tmp_path / "with", judged_walls(sweeps), sweeps)
    assert content["dataset"]["length_m"] > 100.0 and content["revisits"]["count"] == 3
    bare = replace(sweeps, track=None)
    content, _, revisits = written(tmp_path / "without", replace(judged_walls(sweeps), revisits=[]), bare)
    assert content["dataset"]["length_m"] is None and content["revisits"] is None and revisits == []


def test_the_log_and_the_forms_for_build_servers_name_remedies_in_the_words_of_who_asked(tmp_path: Path) -> None:
    late = f"the stamps are 0.179 s late; {Remedy.GIVE_TIME_OFFSET} -0.179"
    summary = {
        **{"per_window": [], "per_revisit": [], "per_step": [], "per_span": [], "not_judged": [], "warnings": []},
        **{"mqslam_version": "1", "dataset": {"path": "drive", "format": "native"}, "trajectory": None},
        "verdict": {"status": VerdictStatus.WARN, "diagnosis": late, "reasons": [late]},
        "tests": {"pooled": {"status": VerdictStatus.WARN, "p_value": 1e-9, "reasons": [late]}},
        "notes": [f"an offset of 0.3 m is assumed: {Remedy.OVERRIDE_RANGE_OFFSET}"],
    }
    write_audit(tmp_path, CONFIG, summary, name_options)
    log, *gates = ((tmp_path / name).read_text() for name in ("run.log", "audit.md", "junit.xml"))
    assert "note: an offset of 0.3 m is assumed: --set sensor.range_offset_m=METRES overrides it\n" in log
    assert all("late; give --time-offset -0.179" in text and "give a time offset" not in text for text in (log, *gates))
    assert json.loads((tmp_path / "audit.json").read_text())["verdict"]["diagnosis"] == late


def test_a_table_without_rows_still_names_its_columns(tmp_path: Path) -> None:
    rows = {"per_window": [], "per_revisit": [], "per_step": [], "per_span": []}
    judged = {
        "verdict": {"status": "not judged", "diagnosis": "no points", "reasons": ["no points"]},
        "not_judged": [],
        "warnings": ["few points"],
    }
    origin = {"mqslam_version": "1", "dataset": {"path": "drive", "format": "native"}, "trajectory": None}
    write_audit(tmp_path, CONFIG, {**rows, **judged, **origin})
    log = (tmp_path / "run.log").read_text()
    assert log.startswith("mqslam 1: audit of drive (native)\nfinished: ") and "\ncommand: " in log and "\nversions: " in log
    assert "warning: few points\nverdict: not judged: no points\n" in log
    for name, columns in {
        "audit": "t0,t1,x,y,yaw,torn",
        "revisits": "t_earlier,t_later",
        "steps": "t,x",
        "spans": "t_e",
    }.items():
        (header,) = (tmp_path / f"{name}.csv").read_text().splitlines()
        assert header.startswith(columns) and header.count(",") > 8
