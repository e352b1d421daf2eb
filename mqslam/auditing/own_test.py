"""Loads and runs the tests of a map that a user adds to an audit, each in a Python file of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.table import TESTS, MapTest
from mqslam.auditing.verdict import Cause, Finding, VerdictStatus
from mqslam.config import AuditConfig
from mqslam.core.own_files import NO_IMPORT, STOPPED, blame, import_file
from mqslam.errors import ConfigError


def load_test(path: Path) -> MapTest:
    """Loads from a Python file the `MapTest` that the file defines, with its function `judge`.

    Raises:
        ConfigError: the file is missing, cannot be imported, defines no or several such tests, or gives the test a name that
            one of mqslam's own tests has.
    """
    if not path.is_file():
        raise ConfigError(f"test {path}: there is no such file; check the path")
    with blame(f"test {path}", NO_IMPORT, ConfigError, "mend the file"):
        module = import_file(path.resolve(), "map_test")
    tests = [one for one in vars(module).values() if isinstance(one, MapTest) and one.judge is not None]
    if len(tests) != 1:
        raise ConfigError(f"test {path}: defines {len(tests)} MapTest objects with a function judge; define exactly one")
    if tests[0].name in {test.name for test in TESTS}:
        raise ConfigError(f"test {path}: mqslam has a test of the name {tests[0].name}; choose another name")
    return tests[0]


def judge_by(test: MapTest, sweeps: Sweeps, settings: AuditConfig) -> list[Finding]:
    """Judges a map by a test that a user has added; returns the findings of the test.

    Args:
        test: the test, which has a function `judge`.
        sweeps: points under the trajectory to judge.
        settings: settings of the audit.

    Raises:
        ConfigError: the test stops with an error, or returns something other than findings.
    """
    assert test.judge is not None, test
    with blame(f"test {test.name}", STOPPED, ConfigError, "mend the file of the test"):
        findings = list(test.judge(sweeps, settings))
    if not all(isinstance(one, Finding) for one in findings):
        raise ConfigError(f"test {test.name}: returned something other than Finding objects; mend the file of the test")
    return [_explain(one) for one in findings]


def _explain(finding: Finding) -> Finding:
    """Returns a finding unchanged, or with its reason as explanation if it has the verdict `fail` and names no cause."""
    if finding.status is not VerdictStatus.FAIL or finding.cause is not None:
        return finding
    return replace(finding, cause=Cause.OWN, explanation=finding.reason)
