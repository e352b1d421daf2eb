"""An audit as a gate: what got worse, and its forms for build servers."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from mqslam.results.audit_gate import format_junit, format_markdown, list_worse


def audited(baseline: dict[str, Any] | None = None, **statuses: str) -> dict[str, Any]:
    """Returns an audit.json with the statuses of the verdict and of tests."""
    tests = {name: {"status": status, "p_value": None, "reasons": [f"<{name}> | said"]} for name, status in statuses.items()}
    verdict = {**tests.pop("verdict"), "diagnosis": "a *bold* \x1b[31m claim"}
    subject = {"dataset": {"path": "a_drive", "format": "native"}, "trajectory": "slam.tum"}
    return {"verdict": verdict, "tests": tests, "baseline": baseline, **subject}


def test_a_status_that_is_graver_than_before_is_worse() -> None:
    before = audited(verdict="warn", steps="pass", spans="warn", sums="fail", gone="pass", speeds="not judged")
    now = audited(verdict="fail", steps="not judged", spans="fail", sums="warn", new="fail", speeds="pass")
    assert list_worse(now, before) == [
        "verdict is fail and was warn",
        "steps is not judged and was pass",
        "spans is fail and was warn",
    ]
    assert list_worse(before, before) == []


def test_markdown_has_a_row_per_test_and_nothing_active() -> None:
    worse = {"path": "old", "worse": ["steps is warn and was pass"]}
    lines = format_markdown(audited(worse, verdict="warn", steps="warn", spans="pass")).splitlines()
    assert lines[0] == "## mqslam audit: warn" and "a \\*bold\\* " in lines[2] and "\x1b" not in lines[2]
    assert "- steps is warn and was pass" in lines and r"| spans | pass | \<spans\> \| said |" in lines
    assert "nothing is worse" in format_markdown(audited(worse | {"worse": []}, verdict="pass"))
    assert "Compared with my\\_old, this is worse:\n\n- steps" in format_markdown(
        audited(worse | {"path": "my_old"}, verdict="warn")
    )
    assert lines[4] == r"Audited: a\_drive (native) under slam.tum"
    cloud = audited(verdict="pass") | {"dataset": {"path": "map.ply", "format": "ply"}, "trajectory": None}
    assert "\n\nAudited: map.ply (ply)\n\n| test |" in format_markdown(cloud)
    said = {
        "covariances": {"statement": "they are too small"},
        "mended": {"sentence": "Mended."},
        "warnings": ["no <odometry>"],
        "notes": ["they are too small", "another drive"],
    }
    subject = "Audited: a\\_drive (native) under slam.tum"
    listed = f"{subject}\n\n- they are too small\n- Mended.\n- another drive\n- no \\<odometry\\>\n\n| test |"
    assert listed in format_markdown(audited(verdict="pass") | said)
    for given in (worse, worse | {"worse": []}, None):
        text = format_markdown(audited(given, verdict="warn", steps="warn"))
        assert " \n" not in text and "\n\n\n" not in text and "\n\n| test |" in text and not text.endswith("\n\n")
    assert "Compared" not in format_markdown(audited(verdict="pass"))


def test_junit_fails_what_fails_or_is_worse() -> None:
    worse = {"path": "old", "worse": ["steps is warn and was pass"]}
    now = audited(worse, verdict="warn", steps="warn", spans="pass", sums="fail", pooled="warn", speeds="not judged")
    suite = ElementTree.fromstring(format_junit(now))
    assert suite.attrib == {"name": "mqslam audit", "tests": "6", "failures": "2", "skipped": "1"}
    outcomes = {case.get("name"): case[0].tag for case in suite}
    assert outcomes == {
        **{"steps": "failure", "spans": "system-out", "sums": "failure", "pooled": "system-out"},
        **{"speeds": "skipped", "verdict": "system-out"},
    }
    assert suite[0][0].get("message") == "steps is warn and was pass; <steps> | said"


ACTION = Path(__file__).parents[2] / "action.yml"


@pytest.mark.parametrize(("code", "reported"), [(0, True), (1, True), (2, False), (3, True)])
def test_the_github_action_reports_no_audit_from_before(code: int, reported: bool, tmp_path: Path) -> None:
    """The command fails with 2 where the folder for the results exists: the audit in this folder is an earlier one."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "audit.md").write_text("## mqslam audit: pass\n")
    (tmp_path / "out" / "audit.json").write_text('{"verdict": {"status": "pass"}}')
    (tmp_path / "mqslam").write_text(f"#!/bin/sh\nexit {code}\n")
    (tmp_path / "mqslam").chmod(0o755)
    step = yaml.safe_load(ACTION.read_text(encoding="utf-8"))["runs"]["steps"][1]
    inputs = {name: "" for name in step["env"]} | {"OUT": "out", "DATA": "drive"}
    given = {"GITHUB_STEP_SUMMARY": "summary", "GITHUB_OUTPUT": "output", "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-e", "-c", step["run"]], env=inputs | given, cwd=tmp_path, check=False)
    assert done.returncode == code
    assert (tmp_path / "summary").exists() == reported and (tmp_path / "output").exists() == reported


def test_the_github_action_calls_what_exists() -> None:
    action = yaml.safe_load(ACTION.read_text(encoding="utf-8"))
    assert action["runs"]["using"] == "composite" and set(action["outputs"]) == {"verdict"}
    steps = action["runs"]["steps"]
    assert all(step["shell"] == "bash" for step in steps)
    used = {value for step in steps for value in step.get("env", {}).values()}
    assert used == {f"${{{{ inputs.{name} }}}}" for name in action["inputs"]}
