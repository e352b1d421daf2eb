"""What the tests of the reports share: a reader of pages, a browser, and a small audited map."""

from __future__ import annotations

import base64
import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.chrome.webdriver import WebDriver
from selenium.webdriver.common.actions.action_builder import ActionBuilder
from selenium.webdriver.support.ui import WebDriverWait

from mqslam.auditing.findings import judge_locally, judge_revisits, judge_windows
from mqslam.auditing.judge import Audit
from mqslam.auditing.registration import Registration
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.speeds import find_capture_range
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.tracks import Track
from mqslam.auditing.verdict import Finding, Verdict, VerdictStatus, verdict_of
from mqslam.auditing.windows.inflation import Bend
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import AuditConfig, EstimatorConfig, VerdictConfig
from mqslam.core import se2
from mqslam.mapping.measures import Measures

WINDOW = 6
PATIENCE_S = 600.0  # for a browser on a busy machine; it only ends what hangs

AXE = Path(os.environ.get("MQSLAM_AXE", Path(__file__).parents[2] / ".axe" / "node_modules" / "axe-core" / "axe.min.js"))
RUN_AXE = """
    const done = arguments[arguments.length - 1];
    axe.run(document, { resultTypes: ["violations"] }).then(({ violations }) => done(violations.map(
        ({ id, impact, nodes }) => [impact, `${id}: ${nodes.map((node) => node.target.join(" ")).join(", ")}`])));
"""

Motion = tuple[float, float, float]


@dataclass
class Page(HTMLParser):
    """What a browser would see: images, names of drawings, addresses, text and whether every tag that opens closes."""

    images: dict[str, bytes] = field(default_factory=dict)
    drawings: list[str] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)
    tags: list[str] = field(default_factory=list)
    text: str = ""
    open_tags: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        given = {name: value or "" for name, value in attrs}
        self.addresses += [given[name] for name in ("src", "href", "srcset", "action") if name in given]
        if tag == "img":
            self.images[given["alt"]] = base64.b64decode(given["src"].removeprefix("data:image/png;base64,"))
        if given.get("role") == "img":
            self.drawings.append(given["aria-label"])
        if tag not in ("meta", "img", "br", "link"):
            self.open_tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open_tags and self.open_tags[-1] not in ("style", "script"):
            self.text += data + "\n"


def page_of(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    page.close()
    assert page.open_tags == []
    return page


def assert_alone(path: Path) -> None:
    """Checks that a page brings everything with it, and would be kept from fetching anything."""
    page, text = page_of(path), path.read_text(encoding="utf-8")
    assert page.addresses and all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert not {"link", "iframe"} & set(page.tags)
    assert "Content-Security-Policy" in text and "default-src 'none'" in text
    assert not re.search(r"https?://|url\((?!#)|@import", re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))


@contextmanager
def chromium(width: int = 1360, height: int = 1000) -> Iterator[WebDriver]:
    """Yields a browser without a window; the test is skipped where Chromium or its driver is missing."""
    browser, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if browser is None or driver is None:
        pytest.skip("Chromium or chromedriver is not installed")
    options = Options()
    options.binary_location = browser
    for flag in ("headless=new", "no-sandbox", "enable-unsafe-swiftshader", "use-gl=angle", "use-angle=swiftshader"):
        options.add_argument(f"--{flag}")
    for flag in ("disable-background-networking", "disable-component-update", "disable-sync", "no-first-run"):
        options.add_argument(f"--{flag}")
    options.add_argument(f"--window-size={width},{height}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    result = webdriver.Chrome(options=options, service=Service(driver))
    result.set_script_timeout(PATIENCE_S)
    try:
        yield result
    finally:
        result.quit()


def opened(browser: WebDriver, path: Path) -> None:
    """Opens a report and waits until its map can be moved in; the test fails on any message in the console."""
    browser.get(path.as_uri())
    ready = "return document.body.classList.contains('ready')"
    WebDriverWait(browser, PATIENCE_S).until(lambda b: b.execute_script(ready))
    assert browser.get_log("browser") == []


def find_faults(path: Path, scheme: str, width: int) -> list[str]:
    """Returns what axe-core finds in a page that those who do not see or use no mouse would stumble over.

    Args:
        path: the page.
        scheme: light or dark.
        width: of the window [pixels].
    """
    if not AXE.is_file():
        pytest.skip(f"axe-core is not at {AXE}: npm install --prefix .axe axe-core@4, or name its axe.min.js in MQSLAM_AXE")
    with chromium(width, 1000) as browser:
        wanted = {"media": "", "features": [{"name": "prefers-color-scheme", "value": scheme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", wanted)
        if 'id="scene"' in path.read_text(encoding="utf-8"):
            opened(browser, path)
        else:
            browser.get(path.as_uri())
        browser.execute_script("document.querySelectorAll('details').forEach((fold) => { fold.open = true; });")
        browser.execute_script(AXE.read_text(encoding="utf-8"))
        return [fault for impact, fault in browser.execute_async_script(RUN_AXE) if impact in ("serious", "critical")]


def click_curve(browser: WebDriver, name: str, number: int) -> float:
    """Clicks with the mouse on a point of a curve over time, and returns its time [s]."""
    script = """
        const gd = document.getElementById("charts"), trace = gd.data.find((t) => t.name === arguments[0]);
        gd.scrollIntoView({ block: "center" });
        const layout = gd._fullLayout, x = trace.x[arguments[1]], y = trace.y[arguments[1]];
        const ax = layout.xaxis, ay = layout["yaxis" + (trace.yaxis || "y").slice(1)], box = gd.getBoundingClientRect();
        return [x, box.left + ax._offset + ax.d2p(x), box.top + ay._offset + ay.d2p(y)];
    """
    time, x, y = browser.execute_script(script, name, number)
    mouse = ActionBuilder(browser)
    mouse.pointer_action.move_to_location(round(x) - 2, round(y)).move_to_location(round(x), round(y))
    mouse.perform()
    hovered = "return (document.getElementById('charts')._hoverdata || []).length > 0"  # clicks count where it hovers
    WebDriverWait(browser, PATIENCE_S).until(lambda b: b.execute_script(hovered))
    mouse = ActionBuilder(browser)
    mouse.pointer_action.click()
    mouse.perform()
    return float(time)


def swept_walls(count: int = 60, per_sweep: int = 40) -> Sweeps:
    """Returns a drive of `count` sweeps 5 m apart, out along x between two walls and back on the same way."""
    rng = np.random.default_rng(5)
    out = np.minimum(np.arange(count), np.arange(count)[::-1])
    poses = np.column_stack([5.0 * out, 0.5 * (np.arange(count) > count // 2), np.zeros(count)])
    sweep = np.repeat(np.arange(count), per_sweep)
    along = rng.uniform(-30.0, 30.0, len(sweep))
    across = rng.choice([-8.0, 12.0], len(sweep)) + 0.1 * rng.normal(size=len(sweep))
    points = poses[sweep, :2] + np.column_stack([along, across])
    return Sweeps(
        points=points,
        covariances=np.tile([0.01, 0.0, 0.01], (len(sweep), 1)),
        turns=sweep + np.tile(np.linspace(0.0, 0.95, per_sweep), count),
        begins=np.arange(0, len(sweep) + 1, per_sweep),
        numbers=np.arange(count, dtype=np.float64),
        times=0.25 * np.arange(count),
        poses=poses,
        travelled=se2.path_lengths(poses),
        doubt_m=np.zeros(count),
        revolution_s=0.25,
        track=Track(0.25 * np.arange(count), poses, count, 0),
    )


def judged_window(sweeps: Sweeps, begin: int, inflation: float, correction: Motion, torn: bool) -> WindowAudit:
    end = begin + WINDOW
    size_m = 0.3 * float(np.hypot(*correction[:2]))
    bend = Bend(np.array(correction), 1e-4 * np.eye(3), inflation, size_m, 0.6, 0.5, 0.8, 0.85, 240)
    beside = Measures(0.4, 0.07, float("nan") if begin == 0 else 0.2, 0.41)
    return WindowAudit(begin, end, 0.25 * begin, 0.25 * end, sweeps.poses[begin + 3], bend, beside, torn)


def judged_revisit(earlier: int, later: int, offset: Motion, torn: bool, sure: bool = True) -> RevisitAudit:
    at, covariance = np.zeros(3), 0.01 * np.eye(3)
    passes = Registration(earlier, later, at, 50.0, np.array(offset), covariance, at[:2], 30.0, 0.7, 1.5, 1.2, sure, sure)
    return RevisitAudit(passes, covariance, 0.0, 900.0, sure, torn)


def judged_walls(sweeps: Sweeps) -> Audit:
    """Audits the drive of `swept_walls`: a torn window, a torn revisit, one that is well and one that is not sure."""
    inflations = np.random.default_rng(6).chisquare(3, len(sweeps) // WINDOW)
    windows = [
        judged_window(sweeps, WINDOW * k, float(inflation), (0.01, -0.02, 0.001), False)
        for k, inflation in enumerate(inflations)
    ]
    windows[3] = judged_window(sweeps, 3 * WINDOW, 120.0, (0.5, -0.25, 0.02), True)
    revisits = [
        judged_revisit(16, 43, (0.02, 0.0, 0.0), False),
        judged_revisit(9, 50, (-1.25, 0.5, -0.02), True),
        judged_revisit(5, 54, (6.0, 0.0, 0.0), False, sure=False),
    ]
    return audit_of(windows, revisits, *judge_map(windows, revisits, len(sweeps)))


def judge_map(
    windows: list[WindowAudit],
    revisits: list[RevisitAudit] | None,
    scans: int,
    others: Sequence[Finding] = (),
) -> tuple[VerdictStatus, list[str]]:
    """Returns the verdict on a map by its windows and, unless it has no trajectory, its revisits, and the reasons."""
    last = judge_locally(windows) if revisits is None else judge_revisits(revisits, AuditConfig(), VerdictConfig())
    status, _, reasons = verdict_of({"others": others, "windows": judge_windows(windows, scans), "revisits": [last]})
    return status, reasons


def audit_of(
    windows: list[WindowAudit],
    revisits: list[RevisitAudit],
    status: VerdictStatus = VerdictStatus.PASS,
    reasons: Sequence[str] = (),
) -> Audit:
    """Returns the judgement of a map of which only windows and revisits were judged."""
    capture = find_capture_range(0.25, EstimatorConfig())
    return Audit(windows, [], [], [], [], None, revisits, {}, Verdict(status, "", list(reasons)), capture)
