"""Commands on recordings that hold next to nothing: whole results in strict JSON, or one line that says why not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import Result, mqslam, parse_strict_json
from support.hard_recordings import HARD, write

from mqslam.formats.tum import read_tum

NOTHING_TO_SEE = ("no return in any scan", "one return in every scan", "one scan")
QUIET = ("--jobs", "1", "--quiet")


def assert_refused(result: Result, out: Path) -> None:
    """Checks that the command says in one line why there is no result, and leaves none."""
    assert result.code == 2
    assert result.err.startswith("mqslam: error: ")
    assert result.err.count("\n") == 1
    assert not (out / "report.html").exists()


def assert_run_written(out: Path) -> dict[str, Any]:
    """Checks that a run has left its files, with finite numbers, and returns the summary."""
    assert (out / "report.html").stat().st_size > 0
    for name in ("trajectory.tum", "odometry.tum"):
        assert np.isfinite(read_tum(out / name).poses).all()
    summary = parse_strict_json((out / "summary.json").read_text())
    assert np.isfinite(summary["doppler_beta"])
    return summary


RUNS = ("first two scans without returns", "three returns from the seventh scan on", "two scans")


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("three scans without returns", "a gap of a minute")]


@pytest.mark.parametrize("name", [*RUNS, *SLOW])
def test_a_hard_recording_is_run(name: str, tmp_path: Path) -> None:
    data, _ = write(tmp_path, HARD[name]())
    result = mqslam("run", data, "--out", tmp_path / "run", *QUIET)
    assert (result.code, result.err) == (0, "")
    assert_run_written(tmp_path / "run")


@pytest.mark.parametrize("name", NOTHING_TO_SEE)
def test_a_recording_without_motion_in_it_is_not_run(name: str, tmp_path: Path) -> None:
    data, _ = write(tmp_path, HARD[name]())
    assert_refused(mqslam("run", data, "--out", tmp_path / "run", *QUIET), tmp_path / "run")
    assert mqslam("info", data).code == 0
    assert mqslam("check", data).code in (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["three scans without returns", "one scan again and again", "bare walls"])
def test_front_ends_are_compared_on_a_hard_recording(name: str, tmp_path: Path) -> None:
    data, truth = write(tmp_path, HARD[name]())
    rows = ("--frontends", "psi,kiss_icp", "--trajectory", f"truth={truth}")
    result = mqslam("compare", data, "--out", tmp_path / "compared", *rows, *QUIET)
    assert (result.code, result.err) == (0, "")
    outcome = parse_strict_json((tmp_path / "compared" / "compare.json").read_text())["rows"]
    assert [(row["name"], row["failure"]) for row in outcome] == [("psi", None), ("kiss_icp", None), ("truth", None)]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no return in any scan", ["audit", "--trajectory", "truth.tum"]),
        ("one scan", ["audit", "--trajectory", "truth.tum"]),
        pytest.param("no return in any scan", ["compare", "--frontends", "psi,kiss_icp"], marks=pytest.mark.slow),
    ],
)
def test_what_shows_nothing_is_neither_audited_nor_compared(
    name: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, _ = write(tmp_path, HARD[name]())
    monkeypatch.chdir(tmp_path)
    assert_refused(mqslam(words[0], data, *words[1:], "--out", tmp_path / "out", *QUIET), tmp_path / "out")


AUDITS = ("returns in the first scan only", "returns in the last scan only", "one return in every scan")


@pytest.mark.parametrize("name", AUDITS)
def test_a_hard_recording_is_audited(name: str, tmp_path: Path) -> None:
    data, truth = write(tmp_path, HARD[name]())
    result = mqslam("audit", data, "--trajectory", truth, "--out", tmp_path / "audited", *QUIET)
    assert (result.code, result.err) == (0, "")
    outcome = parse_strict_json((tmp_path / "audited" / "audit.json").read_text())
    assert all(scan["points"] > 0 for scan in outcome["per_window"])
