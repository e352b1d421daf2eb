from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from selenium.webdriver.support.ui import WebDriverWait
from support.reported import (
    PATIENCE_S,
    assert_alone,
    audit_of,
    chromium,
    click_curve,
    find_faults,
    judged_revisit,
    judged_walls,
    judged_window,
    opened,
    page_of,
    swept_walls,
)

from mqslam.auditing.laying import Laid
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.steps import StepAudit
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import Undecided
from mqslam.config import Config
from mqslam.core import se2
from mqslam.report.audit_page import write_audit_report
from mqslam.report.explorers.audit_explorer import explore_audit
from mqslam.report.figures.audit_figures import draw_heat_map, draw_inflation
from mqslam.report.figures.crops import Crop, make_crop, make_crops
from mqslam.report.formatting import describe_motion
from mqslam.report.inputs.audit_report import AuditReport
from mqslam.report.places.spots import find_worst_spots


def a_report() -> AuditReport:
    sweeps = swept_walls()
    audit = judged_walls(sweeps)
    return AuditReport(
        title="map <01>",
        summary={
            "mqslam_version": "9.8.7",
            "verdict": {"status": "warn", "reasons": ["1 of 10 windows & 1 of 2 revisits <torn>"]},
            "dataset": {"format": "mulran", "path": "/data/<run>", "sweeps": 60, "length_m": 295.0, "duration_s": 15.0},
            "trajectory": "given & <kept>.tum",
            "windows": {"count": 10, "torn": 1, "inflation_median": 2.4},
            "revisits": {"count": 3, "sure": 2, "torn": 1, "worst_m": None},
            "pooled": {"spans": 9, "yaw_per_m": 0.001, "yaw_per_m_sigma": 0.0001},
            "per_window": [{"t0": 0.0}],
        },
        sweeps=sweeps,
        audit=audit,
        config=Config(),
        warnings=("sweep 7 <img src=x> holds nothing",),
        settings_yaml="audit:\n  window: 6  # <sweeps>\n",
    )


def crops_of(report: AuditReport) -> tuple[Crop, ...]:
    return make_crops(report.sweeps, report.audit, report.config.audit)


@pytest.fixture(scope="module")
def report() -> AuditReport:
    return a_report()


@pytest.fixture(scope="module")
def written(report: AuditReport, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("audit") / "report.html"
    write_audit_report(path, report)
    return path


def test_the_page_needs_nothing_from_outside(written: Path) -> None:
    assert_alone(written)


def test_what_is_written_by_others_is_escaped(written: Path) -> None:
    text = page_of(written).text
    for shown in ("map <01>", "<img src=x>", "& 1 of 2 revisits <torn>", "/data/<run>", "given & <kept>.tum", "# <sweeps>"):
        assert shown in text
    assert not re.search(r"<(img src=x|torn|run|kept|sweeps|01)>", written.read_text(encoding="utf-8"))


def test_the_verdict_stands_before_the_warnings_and_these_before_the_numbers(written: Path) -> None:
    text = page_of(written).text
    assert text.index("warn\n") < text.index("<img src=x>") < text.index("of windows torn: 1 of 10") < text.index("Heat map")


@pytest.mark.parametrize("agrees", [True, False, None])
def test_a_gyroscope_that_contradicts_nothing_is_a_note(tmp_path: Path, agrees: bool | None) -> None:
    told = "what the gyroscope says of the trajectory"
    report = a_report()
    summary = {**report.summary, "gyroscope": {"agrees": agrees, "statement": told}}
    write_audit_report(tmp_path / "report.html", replace(report, summary=summary))
    assert (f"Notes\n{told}" in page_of(tmp_path / "report.html").text) == (agrees is not False)


def test_tiles_say_what_is_torn_and_by_how_much(written: Path) -> None:
    text = page_of(written).text
    for shown in ("10.0 %\nof windows torn", "2.37 expected", "0.17 m\nworst window", "1 of 2\nrevisits torn"):
        assert shown in text, shown


def test_the_worst_place_is_listed_first_with_size_and_direction(written: Path) -> None:
    text = page_of(written).text
    motion = "1.25 m back, 0.50 m left, turned 1.1° right"
    row = "\n".join(("1", "revisit", "2.2 s and 12.5 s", "(45, 0) m", "1.35 m", motion))
    assert row in text
    assert text.index(row) < text.index("4.5 s to 6.0 s")


def test_what_is_not_torn_unfolds(written: Path) -> None:
    page = written.read_text(encoding="utf-8")
    places = page[page.index("<h2>Worst places</h2>") : page.index("<h2>What could not be matched</h2>")]
    shown, folded = places.split('<details class="card">')
    assert ">torn</td>" in shown and ">not torn</td>" not in shown
    assert ">not torn</td>" in folded and ">torn</td>" not in folded
    unmatched = page[page.index("<h2>What could not be matched</h2>") : page.index("<h2>Before and after</h2>")]
    assert "its two passes are not sure" in unmatched and "revisits.csv, rows whose torn is unknown" in unmatched


def test_an_undecided_window_is_not_said_to_be_whole(tmp_path: Path) -> None:
    sweeps = swept_walls()
    windows = [judged_window(sweeps, 6 * k, 1.0 + k, (0.02, 0.0, 0.0), False) for k in range(10)]
    windows[9] = replace(windows[9], undecided=Undecided.GAP)
    audit = audit_of(windows, [])
    worst = find_worst_spots(sweeps, audit, Config().audit)[0]
    assert worst.text.endswith("Inflation 10, undecided: its motion is interpolated across a gap of the trajectory.")
    write_audit_report(tmp_path / "report.html", replace(a_report(), sweeps=sweeps, audit=audit))
    page = page_of(tmp_path / "report.html")
    assert "10\nundecided: its motion is interpolated across a gap" in page.text and "nothing could be decided" in page.text
    chart = explore_audit(sweeps, audit, Config().audit).charts[0]
    assert {curve.name: len(curve.times) for curve in chart.curves} == {"inflation": 9, "inflation: undecided": 1}
    picture = draw_inflation(audit)
    decided = draw_inflation(audit_of([replace(w, undecided=None) for w in windows], []))
    assert picture != decided


def test_the_tests_stand_side_by_side_with_their_p_values(tmp_path: Path) -> None:
    tests = {
        "windows": {"status": "pass", "p_value": 0.31, "reasons": ["0 of 10 windows are torn"]},
        "steps": {"status": "warn", "p_value": 3e-9, "reasons": ["the map jumps"]},
        "revisits": {"status": "pass", "p_value": None, "reasons": ["it comes back to no place"]},
    }
    report = a_report()
    found = {"tests": tests, "false_alarms": {"rate": 0.02, "p_value_below": 0.0025}}
    write_audit_report(tmp_path / "report.html", replace(report, summary=report.summary | found))
    text = page_of(tmp_path / "report.html").text
    assert "a p-value of 0.0025 or more" in text and "no more than 2 % of the good maps" in text
    assert "p-value" in text and "pass\n0.31\n0 of 10" in text and "warn\n< 0.0001\nthe map jumps" in text
    assert "pass\n–\nit comes back" in text
    assert text.index("the map jumps") < text.index("2 tests passed") < text.index("0 of 10")


def test_measures_of_windows_without_a_value_leave_the_others(written: Path) -> None:
    text = page_of(written).text
    assert "joint less separate entropy\n0.2 nat\n0.2 nat\n0.2 nat" in text
    assert "mean plane variance\n0.07 m²" in text
    assert "yaw\n0.0573 °/m\nyaw, sigma\n0.00573 °/m" in re.sub(r"\n+", "\n", text)


def test_every_crop_is_shown_before_and_after_on_one_extent(report: AuditReport, written: Path) -> None:
    images = page_of(written).images
    shown = [name for name in images if name.endswith((", before", ", after"))]
    assert len(shown) == 2 * len(crops_of(report)) > 2
    assert len({Image.open(io.BytesIO(images[name])).size for name in shown}) == 1


def test_a_torn_revisit_is_corrected_by_moving_the_later_pass_alone(report: AuditReport) -> None:
    crop = crops_of(report)[0]
    assert crop.title.startswith("revisit 2.2 s and 12.5 s")
    np.testing.assert_array_equal(crop.before[0], crop.after[0])
    moved = crop.after[1][np.argmin(np.hypot(*(crop.after[1]).T))]
    c, s = np.cos(-0.02), np.sin(-0.02)
    back = (moved - [-1.25, 0.5]) @ np.array([[c, -s], [s, c]])
    assert np.hypot(*(crop.before[1] - back).T).min() < 1e-9


def test_a_torn_window_is_corrected_against_its_middle(report: AuditReport) -> None:
    crop = next(c for c in crops_of(report) if c.title.startswith("window 4.5 s"))
    assert len(crop.before) == len(crop.after) == 6
    assert "0.50 m ahead, 0.25 m right" in crop.text


def test_the_worst_places_keep_apart_and_fill_up_with_the_largest_inflation() -> None:
    sweeps = swept_walls(120)
    windows = [judged_window(sweeps, 6 * k, float(k), (0.5, 0.0, 0.0), k in (2, 3)) for k in range(20)]
    revisits = [judged_revisit(9, later, (0.1 * later, 0.0, 0.0), True) for later in (100, 102, 104)]
    spots = find_worst_spots(sweeps, audit_of(windows, revisits), Config().audit, 5)
    assert [(s.kind, s.sweep) for s in spots[:2]] == [("revisit", 104), ("window", 15)]
    assert [s.torn for s in spots] == [True, True, False, False, False]
    begins = [s.sweep for s in spots if s.kind == "window"]
    assert begins[1] == 117
    assert np.diff(np.sort(sweeps.travelled[begins])).min() > 50.0


def test_jumps_and_spans_are_among_the_worst_places_with_what_would_mend_them() -> None:
    sweeps = swept_walls()
    between = se2.between(sweeps.poses[20], sweeps.poses[26])
    jumped = Laid(25, 26, between, 1.0, np.array([-2.0, 0.5, 0.0]), np.eye(3), 2.1, 0.75, 2.0, 1.0, True, True)
    bent = replace(jumped, earlier=20, offset=np.array([0.0, 0.3, 0.01]))
    jump = StepAudit(jumped, 6.5, 1e-9)
    span = SpanAudit(bent, 5.0, 6.5, bent.offset, np.diag([0.01, 0.01, 1e-4]), 1e-9, True)
    whole = replace(span, t0=9.0, torn=False)
    audit = replace(audit_of([], []), jumps=[jump], spans=[span, whole])
    found = find_worst_spots(sweeps, audit, Config().audit)
    assert [(spot.kind, spot.time) for spot in found] == [("jump", "at 6.5 s"), ("span", "5.0 s to 6.5 s")]
    assert found[0].text == (
        "What was seen after it fits where it is moved 2.00 m back, 0.50 m left, which moves its points by 2.10 m; "
        "75 % of its points then lie on what was seen before."
    )
    assert "The end of the span fits 0.30 m from where the trajectory has it, moved 0.30 m left" in found[1].text
    assert found[1].text.endswith("Inflation 10.")
    crop = make_crop(sweeps, found[0])
    assert sum(map(len, crop.before)) and sum(map(len, crop.after))
    np.testing.assert_array_equal(crop.before[0], crop.after[0])
    assert not np.array_equal(crop.before[1], crop.after[1])


def test_directions_are_said_as_a_driver_would() -> None:
    assert describe_motion((1.5, -0.02, 0.01)) == "1.50 m ahead, 20 mm right, turned 0.57° left"
    assert describe_motion((0.0, 0.0, 0.0)) == "nowhere"


def test_the_heat_map_tells_windows_beyond_the_threshold_from_the_others() -> None:
    sweeps = swept_walls()

    def blue_over_red(inflation: float) -> NDArray[np.int64]:
        windows = [judged_window(sweeps, 6 * k, inflation, (0.0, 0.0, 0.0), False) for k in range(10)]
        image = Image.open(io.BytesIO(draw_heat_map(sweeps, audit_of(windows, [])))).convert("RGB")
        pixels = np.asarray(image).astype(np.int64)[200:]  # below the strip of all colours
        return pixels[..., 2] - pixels[..., 0]

    blue, orange = blue_over_red(2.0), blue_over_red(200.0)
    assert (blue > 60).sum() > 1000 > (orange > 60).sum()
    assert (orange < -60).sum() > 1000 > (blue < -60).sum()


def test_the_heat_map_is_opaque_by_itself_and_transparent_in_a_page(report: AuditReport) -> None:
    corners = [
        np.asarray(Image.open(io.BytesIO(draw_heat_map(report.sweeps, report.audit, opaque=opaque))).convert("RGBA"))[2, 2]
        for opaque in (True, False)
    ]
    assert corners[0].tolist() == [255, 255, 255, 255]
    assert corners[1][3] == 0


def test_an_audit_with_nothing_in_it_still_has_a_report(report: AuditReport, tmp_path: Path) -> None:
    nothing = audit_of([], [], VerdictStatus.NOT_JUDGED)
    bare = replace(report, summary={}, audit=nothing, warnings=())
    write_audit_report(tmp_path / "bare.html", bare)
    page = page_of(tmp_path / "bare.html")
    assert set(page.images) == {"Heat map"}
    assert "Warnings" not in page.text
    assert "it comes back to no place" in page.text


def test_a_part_that_cannot_be_drawn_costs_no_other_part(
    report: AuditReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mqslam.report.audit_page.draw_heat_map", lambda *_, **__: 1 / 0)
    monkeypatch.setattr("mqslam.report.sections.audit_places.make_crop", lambda *_: 1 / 0)
    failures = write_audit_report(tmp_path / "partial.html", report)
    why = "could not be made (ZeroDivisionError: division by zero); the other results are whole"
    assert failures == [f"the pictures of the map {why}", f"the pictures of the worst places {why}"]
    page = page_of(tmp_path / "partial.html")
    assert all(page.text.count(failure) >= 2 for failure in failures)  # among the warnings and in the part's place
    assert "Worst places" in page.text and "Measures" in page.text and page.images == {}


def test_an_audit_that_could_not_judge_says_so_in_grey(report: AuditReport, tmp_path: Path) -> None:
    verdict = {"status": VerdictStatus.NOT_JUDGED, "reasons": ["2 scans are too few to judge a map by"]}
    write_audit_report(tmp_path / "few.html", replace(report, summary={"verdict": verdict}))
    assert '<span class="badge none">not judged</span>' in (tmp_path / "few.html").read_text()
    assert "2 scans are too few to judge a map by" in page_of(tmp_path / "few.html").text


def test_the_same_audit_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    write_audit_report(tmp_path / "again.html", a_report())
    assert (tmp_path / "again.html").read_bytes() == written.read_bytes()


@pytest.mark.slow
def test_a_click_on_a_window_shows_it_as_it_is_and_corrected(written: Path) -> None:
    with chromium() as browser:
        opened(browser, written)
        assert browser.find_element("tag name", "h1").text == "map <01>"
        shown = browser.find_element("id", "place")
        assert shown.text.startswith("revisit 2.2 s and 12.5 s")  # what is off the most
        time = click_curve(browser, "inflation", 1)
        WebDriverWait(browser, PATIENCE_S).until(lambda _: shown.text.startswith(f"window {time - 0.75:.1f} s to"))
        views = browser.execute_script("return document.getElementById('crop').layout.annotations.map((a) => a.text)")
        assert views == ["as it is", "corrected"]
        assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault(written: Path, scheme: str, width: int) -> None:
    assert find_faults(written, scheme, width) == []
