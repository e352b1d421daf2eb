"""What the pages of all reports share: HTML with its style and pictures inside, nothing fetched from anywhere."""

from __future__ import annotations

import base64
import math
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib import metadata
from typing import Any, Final

from mqslam.audit.verdict import VerdictStatus
from mqslam.errors import tolerate
from mqslam.report.style import CSS

ABSENT: Final = "–"
_PACKAGES: Final = ("numpy", "scipy", "numba", "gtsam", "open3d", "kiss-icp", "matplotlib")
_UNITS: Final = {"m": " m", "s": " s", "mb": " MB", "percent": " %"}


def page(title: str, head: Iterable[str], parts: Iterable[str], settings_yaml: str, summary: Mapping[str, Any]) -> str:
    """A whole page.

    Args:
        title: its heading, as text.
        head: HTML below the heading: warnings, verdict.
        parts: HTML of its sections.
        settings_yaml: every setting used, as text.
        summary: content of the JSON file beside the page, for the version.
    """
    shown = escape(title)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data: blob:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'">
<title>{shown} · mqslam</title>
<style>{CSS}</style>
</head>
<body>
<header>
<h1>{shown}</h1>
{_lines(head)}
</header>
<main>
{_lines(parts)}
<details class="card"><summary>Settings</summary><pre>{escape(settings_yaml)}</pre></details>
</main>
<footer>{escape(_versions(summary))}</footer>
</body>
</html>
"""


def draw(name: str, part: Callable[[], str], failures: list[str], instead: str = "") -> str:
    """Draw a part of a page; where that fails a line says so, and the other parts stand.

    Args:
        name: what the part is called.
        part: what draws it as HTML.
        failures: where it is added that it could not be drawn.
        instead: HTML that takes its place below that line.
    """
    tried: list[str] = []
    with tolerate(name, tried):
        return part()
    failures += tried
    return note(tried[0]) + instead


def warning_box(warnings: Sequence[str]) -> str:
    """What the reader has to know before the numbers; nothing without any."""
    if not warnings:
        return ""
    items = "".join(f"<li>{escape(w)}</li>" for w in warnings)
    return f'<section class="warnings"><h2>Warnings</h2><ul>{items}</ul></section>'


def verdict_badge(verdict: Mapping[str, Any]) -> str:
    """The verdict {status, reasons}."""
    status = str(verdict.get("status") or "no verdict")
    reasons = "".join(f"<li>{escape(str(r))}</li>" for r in verdict.get("reasons") or ())
    listed = f"<ul>{reasons}</ul>" if reasons else ""
    return f'<section class="verdict">{badge(status)}{listed}</section>'


def badge(status: str) -> str:
    """A verdict's status in its colour; grey where there is no verdict."""
    kind = status if status in ("pass", "warn", "fail") else "none"
    return f'<span class="badge {kind}">{escape(status)}</span>'


def tiles(values: Iterable[tuple[str, str]]) -> str:
    """The numbers to see first, each with what it is."""
    shown = "".join(f'<div class="tile"><b>{escape(v)}</b><span>{escape(label)}</span></div>' for v, label in values)
    return f'<div class="tiles">{shown}</div>'


def picture(png: bytes, heading: str, caption: str = "") -> str:
    """A picture with its heading and a line about it."""
    detail = f"<span>{escape(caption)}</span>" if caption else ""
    return f"<figure><figcaption><b>{escape(heading)}</b>{detail}</figcaption>{image(png, heading)}</figure>"


def image(png: bytes, what: str) -> str:
    """A picture alone; `what` is read to those who do not see it."""
    data = base64.b64encode(png).decode("ascii")
    return f'<img alt="{escape(what)}" src="data:image/png;base64,{data}">'


def captioned(png: bytes, caption: str, what: str) -> str:
    """A small picture within a card; `what` is read to those who do not see it."""
    return f"<div>{image(png, what)}<span>{escape(caption)}</span></div>"


def titled_card(heading: str, content: str, wide: bool = False) -> str:
    """A card of some HTML."""
    kind = "card wide" if wide else "card"
    return f'<section class="{kind}"><h3>{escape(heading)}</h3>{content}</section>'


def note(text: str) -> str:
    """A line of explanation."""
    return f'<p class="soft">{escape(text)}</p>'


def pairs_card(heading: str, rows: Iterable[tuple[str, str]]) -> str:
    """A card of names and values; nothing without any."""
    body = "".join(f"<tr><th>{escape(label)}</th><td>{escape(value)}</td></tr>" for label, value in rows)
    return titled_card(heading, f"<table>{body}</table>") if body else ""


def named_card(heading: str, values: Mapping[str, Any]) -> str:
    """A card of a part of the summary under its own names, whose endings tell the units; what is nested is left out."""
    rows = []
    for key, value in values.items():
        if isinstance(value, Mapping | list | tuple):
            continue
        stem, _, ending = key.rpartition("_")
        name, unit = (stem, _UNITS[ending]) if stem and ending in _UNITS else (key, "")
        rows.append((name.replace("_", " "), number(value, unit)))
    return pairs_card(heading, rows)


def grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with a head; the first column names the rows. A row with one value only has it across all columns.

    Verdicts are shown in their colours, everything else as it is.
    """
    top = "".join(f"<th>{escape(h)}</th>" for h in head)
    body = "".join(f"<tr><th>{escape(label)}</th>{_cells(values, len(head) - 1)}</tr>" for label, *values in rows)
    return f'<table class="numbers"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'


def section(summary: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """A part of the summary, empty where it is absent or None."""
    value = summary.get(key)
    return value if isinstance(value, Mapping) else {}


def number(value: Any, unit: str = "") -> str:
    """A value of the summary as text: four digits that count, thousands separated, a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ABSENT
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}{unit}"
    if isinstance(value, float):
        digits = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
        return f"{digits}{unit}"
    return f"{value}{unit}"


def share(value: Any) -> str:
    """A share, 0..1, in percent."""
    return number(100.0 * value, " %") if isinstance(value, int | float) else ABSENT


def _cells(values: Sequence[str], columns: int) -> str:
    if columns > 1 and values[0] and not any(values[1:]):
        return f'<td class="across" colspan="{columns}">{escape(values[0])}</td>'
    return "".join(f"<td>{badge(v) if isinstance(v, VerdictStatus) else escape(v)}</td>" for v in values)


def _lines(parts: Iterable[str]) -> str:
    return "\n".join(parts)


def _versions(summary: Mapping[str, Any]) -> str:
    found = [f"mqslam {summary.get('mqslam_version', ABSENT)}", f"Python {platform.python_version()}"]
    for package in _PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return " · ".join(found)
