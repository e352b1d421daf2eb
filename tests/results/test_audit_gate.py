"""An audit as a gate: what got worse, and its forms for build servers."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

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
    }
    listed = "Audited: a\\_drive (native) under slam.tum\n\n- they are too small\n- Mended.\n- no \\<odometry\\>\n\n| test |"
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


def test_the_github_action_calls_what_exists() -> None:
    action = yaml.safe_load((Path(__file__).parents[2] / "action.yml").read_text(encoding="utf-8"))
    assert action["runs"]["using"] == "composite" and set(action["outputs"]) == {"verdict"}
    steps = action["runs"]["steps"]
    assert all(step["shell"] == "bash" for step in steps)
    used = {value for step in steps for value in step.get("env", {}).values()}
    assert used == {f"${{{{ inputs.{name} }}}}" for name in action["inputs"]}
