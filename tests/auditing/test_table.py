"""The table of tests: its page, its share of false alarms, and what a user's tolerance does to it."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from mqslam.auditing.table import TESTS, apply_tolerance, share_of_false_alarms, sort_tests
from mqslam.config import AuditConfig, Config, VerdictConfig, set_tolerance
from mqslam.errors import ConfigError

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_page_about_the_verdict_is_made_from_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """`python -c "import generate; print(generate.describe_verdict(), end='')"` in docs/hooks makes it anew."""
    monkeypatch.syspath_prepend(DOCS / "hooks")  # as MkDocs does
    page = runpy.run_path(str(DOCS / "hooks" / "generate.py"))["describe_verdict"]()
    assert (DOCS / "explanation" / "verdict.md").read_text(encoding="utf-8") == page
    assert len(page.splitlines()) < 45  # one screen


def test_all_quantities_together_take_the_rate_of_false_alarms() -> None:
    share = share_of_false_alarms(VerdictConfig(false_alarms=0.012))
    assert share * sum(test.quantities for test in TESTS) == pytest.approx(0.012)


def test_a_users_tolerance_scales_all_of_them_in_proportion() -> None:
    before = AuditConfig()
    after = apply_tolerance(before, set_tolerance(Config(), 0.25).verdict)
    scaled = [test.tolerance for test in TESTS if test.tolerance is not None]
    assert len(scaled) == 6
    for tolerance in scaled:
        wide, narrow = tolerance(before), tolerance(after)
        assert narrow[0] == pytest.approx(0.5 * wide[0])
        assert (narrow[1] is None) is (wide[1] is None)
        assert wide[1] is None or narrow[1] == pytest.approx(0.5 * wide[1])
    assert apply_tolerance(before, VerdictConfig()) is before


@pytest.mark.parametrize("metres", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_that_is_no_length_is_refused(metres: float) -> None:
    with pytest.raises(ConfigError, match="not a length above 0"):
        set_tolerance(Config(), metres)


def test_what_tests_found_is_in_the_order_of_the_table() -> None:
    assert list(sort_tests({"revisits": [1], "windows": [2], "spans": [], "frame": [3]})) == ["frame", "windows", "revisits"]
