"""What the page of an audit shows besides what all pages have."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from selenium.webdriver.support.ui import WebDriverWait
from support.pages import AUDIT_SUMMARY, scene_of, text_of, write_audit
from support.reported import (
    PATIENCE_S,
    audit_of,
    chromium,
    click_curve,
    judged_walls,
    judged_window,
    opened,
    page_of,
    swept_walls,
)

from mqslam.auditing.judge import Audit
from mqslam.auditing.registration import Registration
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.steps import StepAudit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import VerdictStatus
from mqslam.auditing.windows.windows import Undecided
from mqslam.cli.audit import _describe_final_psi
from mqslam.config import Config
from mqslam.report.heat_map import draw_heat_map
from mqslam.report.spots import find_worst_spots


def test_a_map_that_fails_opens_without_a_number_that_looks_like_praise(tmp_path: Path) -> None:
    """No window may be torn in a map that is bent as a whole."""
    tests = {
        "windows": {"status": "pass", "p_value": 0.3, "reasons": ["0 of 10 windows are torn"]},
        "sums": {"status": "fail", "p_value": 1e-9, "reasons": ["the trajectory leads 2 m astray"]},
    }
    verdict = {"status": "fail", "reasons": ["the trajectory leads 2 m astray"]}
    write_audit(tmp_path, {**AUDIT_SUMMARY, "verdict": verdict, "tests": tests})
    page, text = (tmp_path / "report.html").read_text(encoding="utf-8"), text_of(tmp_path)
    assert 'class="tile' not in page
    places = [text.index(shown) for shown in ("leads 2 m astray", "Heat map", "1 test passed", "0 of 10 windows")]
    assert places == sorted(places)
    assert "psi per point" not in text and "psi_per_point" not in text


def test_final_psi_has_the_words_that_the_terminal_and_the_page_about_the_score_have(tmp_path: Path) -> None:
    final = {"over_best_of_windows": 1.03, "over_best_of_passes": None}
    write_audit(tmp_path, {**AUDIT_SUMMARY, "final_psi": final})
    assert "Final ψ\ntimes the best possible in windows\n1.03\ntimes the best possible across passes\n–" in text_of(tmp_path)
    assert _describe_final_psi(final) == "1.03 times the best possible in windows"
    page = (Path(__file__).parents[2] / "docs" / "explanation" / "score.md").read_text(encoding="utf-8")
    assert "`1.03 times the best possible in windows`" in page[page.index("## Final psi") :]


def test_the_worst_place_is_listed_first_with_size_and_direction(pages: dict[str, Path]) -> None:
    text = text_of(pages["audit"])
    motion = "1.25 m back, 0.50 m left, turned 1.1° right"
    row = "\n".join(("1", "revisit", "2.2 s and 12.5 s", "(45, 0) m", "1.35 m", motion))
    assert row in text
    assert text.index(row) < text.index("4.5 s to 6.0 s")


def test_what_is_not_torn_unfolds(pages: dict[str, Path]) -> None:
    page = (pages["audit"] / "report.html").read_text(encoding="utf-8")
    places = page[page.index("<h2>Worst places</h2>") : page.index("<h2>What could not be matched</h2>")]
    shown, folded = places.split('<details class="card">')
    assert ">torn</td>" in shown and ">not torn</td>" not in shown
    assert ">not torn</td>" in folded and ">torn</td>" not in folded
    unmatched = page[page.index("<h2>What could not be matched</h2>") : page.index("<h2>Before and after</h2>")]
    assert "its two passes may also fit" in unmatched and "revisits.csv, rows whose torn is unknown" in unmatched


def test_an_undecided_window_is_not_said_to_be_whole(tmp_path: Path) -> None:
    sweeps = swept_walls()
    windows = [judged_window(sweeps, 6 * k, 1.0 + k, (0.02, 0.0, 0.0), False) for k in range(10)]
    windows[9] = replace(windows[9], undecided=Undecided.GAP)
    assert write_audit(tmp_path, sweeps=sweeps, audit=audit_of(windows, [])) == []
    text = text_of(tmp_path)
    assert "10\nundecided: its motion is interpolated across a gap" in text and "nothing could be decided" in text
    assert "Inflation 10, undecided: its motion is interpolated across a gap of the trajectory." in text
    (chart,) = scene_of(tmp_path)["charts"]
    marks = [(curve["name"], curve["mark"]) for curve in chart["curves"]]
    assert marks == [("inflation", "circle"), ("undecided", "square-open")]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert ">undecided</text>" in page


def test_measures_of_windows_without_a_value_leave_the_others(pages: dict[str, Path]) -> None:
    text = text_of(pages["audit"])
    assert "joint less separate entropy\n0.2 nat (0.2 to 0.2)" in text
    assert "mean plane variance\n0.07 m²" in text
    assert "yaw\n0.0573 °/m\nyaw, sigma\n0.00573 °/m" in text


def test_every_crop_is_shown_before_and_after_on_one_extent(pages: dict[str, Path]) -> None:
    sweeps = swept_walls()
    worst = find_worst_spots(sweeps, judged_walls(sweeps), Config().audit)
    images = page_of(pages["audit"] / "report.html").images
    shown = [name for name in images if name.endswith((", before", ", after"))]
    assert len(shown) == 2 * len(worst) > 2
    assert len({Image.open(io.BytesIO(images[name])).size for name in shown}) == 1


def drawn(sweeps: Sweeps, audit: Audit, *, opaque: bool = True) -> bytes:
    return draw_heat_map(sweeps.points, sweeps.poses[:, :2], audit, opaque=opaque)


def test_the_heat_map_shows_jumps_and_torn_spans() -> None:
    sweeps, fine = swept_walls(), audit_of([], [])
    registration = Registration(
        20, 26, np.zeros(3), 1.0, np.array([-2.0, 0.5, 0.0]), np.eye(3), np.zeros(2), 30.0, 0.75, 2.0, 1.0, True, True
    )
    span = SpanAudit(registration, 5.0, 6.5, registration.offset, np.eye(3), 1e-9, True)
    broken = replace(fine, jumps=[StepAudit(registration, 6.5, 1e-9)])
    bent = replace(fine, spans=[span])

    def count_red(audit: Audit) -> int:
        pixels = np.asarray(Image.open(io.BytesIO(drawn(sweeps, audit))).convert("RGB")).astype(np.int64)
        return int(np.count_nonzero(pixels[..., 0] - pixels[..., 1:].max(axis=-1) > 60))

    whole = count_red(replace(fine, spans=[replace(span, torn=False)]))
    assert count_red(bent) > whole + 1000 and count_red(broken) > whole + 1000


def test_the_heat_map_tells_windows_beyond_the_threshold_from_the_others() -> None:
    sweeps = swept_walls()

    def blue_over_red(inflation: float) -> NDArray[np.int64]:
        windows = [judged_window(sweeps, 6 * k, inflation, (0.0, 0.0, 0.0), False) for k in range(10)]
        image = Image.open(io.BytesIO(drawn(sweeps, audit_of(windows, [])))).convert("RGB")
        pixels = np.asarray(image).astype(np.int64)[200:]  # below the strip of all colours
        return pixels[..., 2] - pixels[..., 0]

    blue, orange = blue_over_red(2.0), blue_over_red(200.0)
    assert (blue > 60).sum() > 1000 > (orange > 60).sum()
    assert (orange < -60).sum() > 1000 > (blue < -60).sum()


def test_the_heat_map_is_opaque_by_itself_and_transparent_in_a_page() -> None:
    sweeps = swept_walls()
    pictures = [drawn(sweeps, judged_walls(sweeps), opaque=opaque) for opaque in (True, False)]
    corners = [np.asarray(Image.open(io.BytesIO(picture)).convert("RGBA"))[2, 2] for picture in pictures]
    assert corners[0].tolist() == [255, 255, 255, 255]
    assert corners[1][3] == 0


def test_an_audit_with_nothing_in_it_still_has_a_report(tmp_path: Path) -> None:
    assert write_audit(tmp_path, {}, audit=audit_of([], [], VerdictStatus.NOT_JUDGED)) == []
    page = page_of(tmp_path / "report.html")
    assert set(page.images) == {"Heat map"}
    assert "Warnings" not in page.text


@pytest.mark.slow
def test_a_click_on_a_window_shows_it_as_it_is_and_corrected(pages: dict[str, Path]) -> None:
    with chromium() as browser:
        opened(browser, pages["audit"] / "report.html")
        shown = browser.find_element("id", "place")
        assert shown.text.startswith("revisit 2.2 s and 12.5 s")  # what is off the most
        time = click_curve(browser, "inflation", 1)
        WebDriverWait(browser, PATIENCE_S).until(lambda _: shown.text.startswith(f"window {time - 0.75:.1f} s to"))
        views = browser.execute_script("return document.getElementById('crop').layout.annotations.map((a) => a.text)")
        assert views == ["as it is", "corrected"]
        assert browser.get_log("browser") == []
