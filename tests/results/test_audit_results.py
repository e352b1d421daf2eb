"""What an audit writes where nothing was decided: `unknown` and null, never `False`."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from support.reported import judged_walls, swept_walls

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows import Undecided
from mqslam.config import Config
from mqslam.results.audit_results import summarise, write_audit

CONFIG = Config()


def written(folder: Path, audit: Audit, sweeps: Sweeps) -> tuple[dict[str, Any], list[str], list[str]]:
    """Writes an audit, and returns its JSON and what its tables say of windows and revisits being torn."""
    folder.mkdir()
    write_audit(folder, CONFIG, summarise(audit, sweeps, CONFIG.audit, CONFIG.verdict, {"path": "drive"}, "given"))
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


def test_without_a_trajectory_there_is_no_path_and_no_revisit(tmp_path: Path) -> None:
    sweeps = swept_walls()
    content, _, _ = written(tmp_path / "with", judged_walls(sweeps), sweeps)
    assert content["dataset"]["length_m"] > 100.0 and content["revisits"]["count"] == 3
    bare = replace(sweeps, track=None)
    content, _, revisits = written(tmp_path / "without", replace(judged_walls(sweeps), revisits=[]), bare)
    assert content["dataset"]["length_m"] is None and content["revisits"] is None and revisits == []
