"""What the pages of all commands have in common."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.pages import AUDIT_SUMMARY, HOSTILE, RUN_SUMMARY, WRITERS, a_run, scene_of, text_of, write_audit, write_run
from support.reported import assert_alone, chromium, find_faults, opened, page_of

from mqslam.auditing.verdict import VerdictStatus
from mqslam.errors import OutputError

LIVE = ("run", "audit", "compare")


@pytest.mark.parametrize("name", LIVE)
def test_a_page_needs_nothing_from_outside(pages: dict[str, Path], name: str) -> None:
    assert_alone(pages[name] / "report.html")


@pytest.mark.parametrize("name", WRITERS)
def test_what_is_written_by_others_is_escaped(pages: dict[str, Path], name: str) -> None:
    hostile = {
        "run": ["/data/<run>"],
        "audit": ["& 1 of 2 revisits <torn>", "/data/<run>", "given & <kept>.tum"],
        "compare": ["_kiss_$icp$ <icp>", "give <FILE>", "/data/<run>", "psi is best, <b>and so on</b>."],
        "batch": ["33 of 40 windows are <torn>", "# <plan>"],
        "merge": ["/data/<a>"],
        "localise": ["<map>"],
    }
    page = page_of(pages[name] / "report.html")
    for shown in ("<run>", HOSTILE, *hostile[name]):
        assert shown in page.text
    assert not {"run", "torn", "kept", "icp", "file", "plan"} & set(page.tags) and "x" not in page.addresses


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("run", ("\nwarn\n", "Something is wrong", "torn near t = 31 s", HOSTILE, "every return in grey", "Map quality")),
        ("audit", ("\nwarn\n", "Something is wrong", HOSTILE, "Heat map", "Measures of the windows")),
        ("compare", ("psi is best", HOSTILE, "drift [%]\n", "running median")),
        ("batch", (HOSTILE, "runs that failed", "against ground truth")),
        (
            "merge",
            ("are one map.", HOSTILE, "is recording 2", "objects that changed", "past it\n1\nrecording 1", "result 2 in"),
        ),
        ("localise", ("97.5 % of 60 scans lie", HOSTILE, "Scans in the map", "across it", "converged\n57\nthe scan lies")),
    ],
)
def test_the_verdict_stands_before_the_warnings_and_these_before_the_numbers(
    pages: dict[str, Path], name: str, order: tuple[str, ...]
) -> None:
    places = [text_of(pages[name]).index(shown) for shown in order]
    assert places == sorted(places)


@pytest.mark.parametrize("name", LIVE)
def test_the_same_result_gives_the_same_bytes(pages: dict[str, Path], tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path)
    assert (tmp_path / "report.html").read_bytes() == (pages[name] / "report.html").read_bytes()


@pytest.mark.parametrize(
    ("name", "broken", "lost", "kept"),
    [
        ("run", "run_page.explore_run", "the map to move in", ("Map quality", "Under odometry", "Optimised", "Trajectory")),
        ("run", "run_page.draw_heat_map", "the map of the verdict", ("Map quality", "Optimised", "Trajectory")),
        ("audit", "audit_page.draw_crop", "the pictures of the worst places", ("Worst places", "Measures", "Heat map")),
        ("compare", "compare_page.draw_difference", "where the rows differ", ("Agreement", "Trajectories")),
        ("batch", "batch_page._describe_run", "the table of the runs", ("runs that failed",)),
        ("merge", "merge_page.draw_change", "the pictures of the changes", ("Recognition", "Trajectories")),
        ("localise", "localise_page.draw_world", "the picture of the map", ("Overlap", "Scans")),
    ],
)
def test_a_part_that_cannot_be_made_costs_no_other_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, broken: str, lost: str, kept: tuple[str, ...]
) -> None:
    monkeypatch.setattr(f"mqslam.report.{broken}", lambda *_, **__: 1 / 0)
    failure = f"{lost} could not be completed (ZeroDivisionError: division by zero); the other results are complete"
    assert WRITERS[name](tmp_path) == [failure]
    text = text_of(tmp_path)
    assert text.count(failure) == 2  # among the warnings, and in the part's place
    assert all(shown in text for shown in kept)


def test_a_full_disk_is_no_part_that_cannot_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> str:
        raise OutputError("no space left")

    monkeypatch.setattr("mqslam.report.run_page.explore_run", full)
    with pytest.raises(OutputError, match="no space left"):
        write_run(tmp_path)


@pytest.mark.parametrize("unjudged", [[], ["drift"]])
def test_a_pass_promises_no_more_than_was_judged(tmp_path: Path, unjudged: list[str]) -> None:
    verdict = {"status": "pass", "reasons": ["0 of 10 windows are torn"]}
    write_run(tmp_path, {**RUN_SUMMARY, "verdict": verdict, "not_judged": unjudged})
    text = text_of(tmp_path)
    assert ("the tests would have shown a bad one" in text) is not bool(unjudged)
    assert ("what could not be judged is listed below" in text) is bool(unjudged)


def test_what_could_not_be_judged_is_grey(tmp_path: Path) -> None:
    verdict = {"status": VerdictStatus.NOT_JUDGED, "reasons": ["2 scans are too few to judge a map by"]}
    write_audit(tmp_path, {"verdict": verdict})
    assert '<span class="badge none">not judged</span>' in (tmp_path / "report.html").read_text()
    assert "2 scans are too few to judge a map by" in text_of(tmp_path)


@pytest.mark.parametrize("agrees", [True, False, None])
def test_a_gyroscope_that_contradicts_nothing_is_a_note(tmp_path: Path, agrees: bool | None) -> None:
    told = "what the gyroscope says of the trajectory"
    write_audit(tmp_path, {**AUDIT_SUMMARY, "gyroscope": {"agrees": agrees, "statement": told}})
    assert (f"Notes\n{told}" in text_of(tmp_path)) == (agrees is not False)


def test_a_page_says_when_and_by_which_command_it_was_made(tmp_path: Path) -> None:
    for name in ("run", "audit"):
        folder = tmp_path / name
        folder.mkdir()
        lines = ("mqslam 9.8.7", "finished: 2026-11-28 14:31:14 UTC", f"command: mqslam {name} <drive>", "command: none")
        (folder / "run.log").write_text("\n".join(lines))
        assert WRITERS[name](folder) == []
        page, text = (folder / "report.html").read_text(), text_of(folder)
        assert f"mqslam {name} &lt;drive&gt;" in page and "command\nnone" not in text
        assert text.index("/data/<run>") < text.index("finished\n2026-11-28 14:31:14 UTC") < text.index("\nwarn\n")


def test_options_stay_in_one_piece(tmp_path: Path) -> None:
    verdict = {"status": "warn", "reasons": ["the scale is wrong: give --range-resolution or a well-known trajectory"]}
    write_audit(tmp_path, {**AUDIT_SUMMARY, "verdict": verdict})
    page = (tmp_path / "report.html").read_text()
    assert 'give <span class="option">--range-resolution</span> or a well-known trajectory' in page


def test_notes_are_no_warnings(tmp_path: Path) -> None:
    write_audit(tmp_path, {**AUDIT_SUMMARY, "notes": ["range bins are <assumed>"], "warnings": []})
    page, text = (tmp_path / "report.html").read_text(), text_of(tmp_path)
    assert "Notes\nrange bins are <assumed>" in text and "Warnings" not in text and 'class="warnings"' not in page


def test_the_tests_of_a_map_stand_side_by_side_with_their_p_values(tmp_path: Path) -> None:
    tests = {
        "windows": {"status": "pass", "p_value": 0.31, "reasons": ["0 of 10 windows are torn"]},
        "steps": {"status": "warn", "p_value": 3e-9, "reasons": ["the map jumps"]},
        "revisits": {"status": "pass", "p_value": None, "reasons": ["it comes back to no place"]},
    }
    write_audit(tmp_path, {**AUDIT_SUMMARY, "tests": tests, "false_alarms": {"rate": 0.02, "p_value_below": 0.0025}})
    text = text_of(tmp_path)
    assert "Errors with a p-value of 0.0025 or more count as chance" in text and "no more than 2 % of the good maps" in text
    assert "p-value" in text and "pass\n0.31\n0 of 10" in text and "warn\n< 0.0001\nthe map jumps" in text
    assert "pass\n–\nit comes back" in text
    assert text.index("the map jumps") < text.index("2 tests passed") < text.index("0 of 10")


def test_settings_and_versions_are_listed(pages: dict[str, Path]) -> None:
    text = text_of(pages["run"])
    assert "max_range_m: 150.0" in text and "mqslam 9.8.7" in text and f"numpy {np.__version__}" in text


@pytest.mark.parametrize("status", ["pass", "fail"])
def test_a_map_that_passes_opens_in_grey_on_its_largest_correction(tmp_path: Path, status: str) -> None:
    summary: dict[str, Any] = {**RUN_SUMMARY, "verdict": {"status": status, "reasons": []}}
    write_run(tmp_path, summary)
    scene = scene_of(tmp_path)
    assert scene["places"][scene["first"]]["kind"] == "torn" and scene["calm"] is (status == "pass")
    assert scene["first_is"] == ("Largest correction (too few are torn to count)" if scene["calm"] else "")
    fine = [window for window in a_run().checks if not window.torn]
    write_run(tmp_path, summary, checks=fine)
    whole = scene_of(tmp_path)
    assert whole["first_is"] == ("Largest correction (harmless)" if whole["calm"] else "")
    assert whole["first"] == int(np.argmax([window.bend.inflation for window in fine]))


def test_importing_the_reports_does_not_load_matplotlib() -> None:
    pages = "run_page, mqslam.report.audit_page, mqslam.report.compare_page, mqslam.report.batch_page"
    code = f"import sys, mqslam.report.{pages}; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.slow
def test_in_print_and_without_scripts_the_pictures_stand_for_the_map(pages: dict[str, Path]) -> None:
    with chromium() as browser:
        opened(browser, pages["run"] / "report.html")
        live, still = (browser.find_element("class name", name) for name in ("live", "still"))
        assert live.is_displayed() and not still.is_displayed()
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        assert still.is_displayed() and not live.is_displayed()


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_on_a_phone_nothing_is_wider_than_the_screen(pages: dict[str, Path], name: str) -> None:
    with chromium(500, 900) as browser:
        browser.get((pages[name] / "report.html").as_uri())
        assert browser.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault(pages: dict[str, Path], name: str, scheme: str, width: int) -> None:
    assert find_faults(pages[name] / "report.html", scheme, width) == []
