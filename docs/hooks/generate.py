"""Makes the pages that the program itself knows best, its command line and its settings, and sets equations.

Equations become MathML, which browsers show by themselves, so that nothing is fetched from elsewhere.
"""

from __future__ import annotations

import html
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from fields import describe_fields
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from origins import CONSTANTS, ORIGINS

from mqslam.auditing.table import TESTS
from mqslam.config import Config, load_config
from mqslam.core.units import LIDAR_CONFIG

ROOT = Path(__file__).parents[2]
PAGES_OF_ROOT = {
    "BENCHMARKS.md": "reference/figures.md",
    "CHANGELOG.md": "reference/changes.md",
    "CONTRIBUTING.md": "how-to/contributing.md",
}
"""Files in the folder of the project, and the pages that they are on the site."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the generated pages, and those from the folder of the project, to the pages in the folder of documentation."""
    pages = {
        "reference/cli.md": describe_commands(),
        "reference/settings.md": describe_settings(),
        "reference/constants.md": describe_constants(),
        "reference/fields.md": "\n".join(describe_fields()),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for name, page in PAGES_OF_ROOT.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Makes the search prefer pages that say what to do to long lists of figures and changes, and fits links to the site.

    In a clone, links lead to files in the folder of the project, and from there to pages.
    """
    part, _, name = page.file.src_uri.partition("/")
    boost = 0.2 if name in ("figures.md", "changes.md") else 2.0 if part in ("how-to", "tutorials") else 1.0
    page.meta["search"] = {"boost": boost}
    for outside, inside in PAGES_OF_ROOT.items():
        markdown = re.sub(rf"\]\((?:\.\./\.\./)?{outside}", f"](../{inside}", markdown)
    if page.file.src_uri in PAGES_OF_ROOT.values():
        markdown = re.sub(r"\]\((?:docs/|(?=notebooks/))", "](../", markdown)
    return markdown


def describe_commands() -> str:
    """Returns the page of the command line, as typer writes it, with examples as code and whole sentences in the lists."""
    command = [sys.executable, "-m", "typer", "mqslam.cli", "utils", "docs", "--name", "mqslam", "--title", "Command line"]
    page = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    whole = {
        name: " ".join(text.split()) for name, text in re.findall(r"^#+ `mqslam (.+)`\n\n((?:.+\n)+)", page, re.MULTILINE)
    }
    for path, text in whole.items():
        name = path.split()[-1]
        page = re.sub(rf"^\* `{name}`: .*\.\.\.$", f"* `{name}`: {text}".replace("\\", r"\\"), page, flags=re.MULTILINE)
    return re.sub(r"^Example: (.+)$", r"```console\n$ \1\n```", page, flags=re.MULTILINE)


def describe_settings() -> str:
    """Returns the page of all settings: a table for each section."""
    lines = ["# Settings", "", "`mqslam config show --all` prints these as YAML, and a file states only what differs.", ""]
    lines += ["Where a lidar has a default of its own (`configs/lidar.yaml`), it stands beside the radar's.", ""]
    lidar = load_config(LIDAR_CONFIG)
    for name, section in Config():
        kind = type(section)
        lines += [
            f"## {name}",
            "",
            (kind.__doc__ or "").splitlines()[0],
            "",
            "| setting | default | what it is |",
            "|---|---|---|",
        ]
        values, others = section.model_dump(mode="json"), getattr(lidar, name).model_dump(mode="json")
        for key, field in kind.model_fields.items():
            description = " ".join((field.description or "").split()).replace("|", "\\|")
            default = f"`{values[key]}`" if others[key] == values[key] else f"`{values[key]}`; lidar: `{others[key]}`"
            lines.append(f"| `{key}` | {default} | {description} |")
        lines.append("")
    return "\n".join(lines)


def describe_constants() -> str:
    """Returns the page of the constants that decide a covariance: where each comes from, and how many come from where."""
    counts = [f"{sum(c.origin == origin for c in CONSTANTS)} {origin}" for origin in ORIGINS]
    lines = [
        "# Constants that decide a covariance",
        "",
        "These standard deviations, floors, priors, factors, shares and random walks decide how large a covariance is: that "
        "of a motion, of a factor, of a sensor's calibration, of the graph or of an audit's registration. The values are "
        "read from the program; the origins are known from comments, benchmarks and the history of the repository.",
        "",
        "The constants by which a lidar's scans are spread, chosen and matched are listed, too, though only some of them "
        "decide a covariance. They were chosen while working on two planar runs, Intel and fr079, which also judge runs of "
        "lidars.",
        "",
        f"There are {len(CONSTANTS)} constants; by origin, {', '.join(counts[:-1])} and {counts[-1]}.",
        "",
        "| origin | what it means |",
        "|---|---|",
        *(f"| {origin} | {meaning} |" for origin, meaning in ORIGINS.items()),
        "",
        "| constant | value | what it decides | origin |",
        "|---|---|---|---|",
    ]
    for constant in CONSTANTS:
        values = ", ".join(f"{number:.6g}" for number in constant.list_numbers())
        origin = f"{constant.origin}: {constant.on}" if constant.on else constant.origin
        lines.append(f"| `{constant.module}` `{constant.name}` | `{values}` | {constant.decides} | {origin} |")
    return "\n".join([*lines, ""])


def on_page_content(content: str, page: Page, **_: Any) -> str:
    """Returns the content of a page with its equations set."""

    def set_equation(match: re.Match[str]) -> str:
        return f'<{match[1]} class="arithmatex">{_set(match[3], is_block=match[2] == "[")}</{match[1]}>'

    def set_in_notebook(match: re.Match[str]) -> str:
        text = re.sub(r"\$\$(.+?)\$\$", lambda one: _set(one[1], is_block=True), match[0], flags=re.DOTALL)
        return re.sub(r"\$([^$]+)\$", lambda one: _set(one[1], is_block=False), text)

    if page.file.src_uri.endswith(".ipynb"):
        return re.sub(r"<(p|li)>.*?</\1>", set_in_notebook, content, flags=re.DOTALL)
    return re.sub(r'<(div|span) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', set_equation, content, flags=re.DOTALL)


def _set(equation: str, *, is_block: bool) -> str:
    """Returns an equation in TeX as MathML."""
    return str(convert(html.unescape(equation).strip(), display="block" if is_block else "inline"))


def describe_verdict() -> str:
    """Returns the page about the verdict: what it says, and the table of its tests."""
    rows, radar, lidar = [], Config().audit, load_config(LIDAR_CONFIG).audit
    for test in TESTS:
        name = f"{test.name} (runs only)" if test.of_run else test.name
        tolerated = [test.describe_tolerance(settings) for settings in (radar, lidar)]
        cells = name, test.compares, tolerated[0], tolerated[1] if tolerated[1] != tolerated[0] else "the same", test.blind
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join([_VERDICT, *rows, "", _AFTER_TABLE])


_VERDICT = """# The verdict

The verdict on a map is `pass`, `warn`, `fail` or `not judged`. Audits and runs take the same tests, except where the
table says otherwise. No test needs ground truth: each test compares parts of the map with each other or with another
sensor, and states the difference in metres and degrees.

1. The first line is the *diagnosis*: the most likely fault and how to correct it, or the number of tests that found no
   fault. A fault that explains others comes first: late stamps tear windows, so that the line names the stamps.
2. The next lines say what each test found, how large it is and where. `fail` comes before `warn`; tests that found
   nothing are left out.
3. The last lines say what could *not* be judged, and the largest error that could be hidden there.

A fault counts only if it is larger than chance explains *and* larger than its tolerance. The table gives the tolerances
for the defaults, 0.5 m between two passes of a radar and 0.25 m between those of a lidar; the tolerances of a lidar
also hold for clouds that no radar made. `--tolerance METRES` scales the tolerances of windows, shaking, steps, spans,
sums and revisits in proportion. Lengths of path are those of a radar: in a lidar's run they follow from the ranges that
it measures, and audits of lidars' logs and of clouds use lengths of rooms (`configs/rooms.yaml`). By chance, one good
map in a hundred is called bad (`--false-alarms`); all tests with a p-value share this rate. If a test looks at a share
(of windows, of revisits), `fail` requires 95 % confidence that the share is above its bound, and with too few places the
map is `not judged`. `fail` means that the map is not to be trusted: more than 20 % of its windows, spans or path or 10 %
of its revisits are wrong, or its scans show that it jumps by more than the tolerated distance of two passes. `warn`
means that something smaller is wrong, or that poses jump and the scans do not show it, as where stamps jitter. A map that
passes may still have the faults that could not be judged.

| test | what it compares | what it tolerates | of a lidar | what it cannot see |
|---|---|---|---|---|"""

_AFTER_TABLE = """[*Final psi*](score.md#final-psi) is psi of the map divided by the best possible psi of the same
returns; at 1.00 each window, or each pass, is as crisp as it can be, whatever jumps and drift lie between them. Only
`graph` uses psi of a whole map, to compare two maps of the same returns. [The tests of a map](map-tests.md) says how each
test works. `audit.json` and `summary.json` hold the diagnosis, the reasons, and each test's verdict and p-value.
"""
