"""Makes the README's picture of a report: `python notebooks/report_picture.py OUT` takes the result of a run.

The notes are added to a copy of the page, which Chromium draws.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

_WIDTH, _HEIGHT = 1400, 960
_NOTES = {
    "dl dd:nth-of-type(4)": "how sure the end is",
    ".verdict .diagnosis": "the verdict, and what is most likely wrong",
    ".unjudged h2": "what nothing could judge, and how large an error could hide",
    "figure figcaption b": "where the map is torn: nowhere on the blue parts of the path",
    "main > h2:first-of-type": "the evidence: tests that found a fault first, passed tests folded",
}
_LOOK = (
    "{{ content: '{note}'; margin-left: 10px; padding: 2px 8px; border: 2px solid #c2187a; border-radius: 10px;"
    " background: #fff; color: #c2187a; font: italic 600 14px sans-serif; white-space: nowrap }}"
)


def main(out: Path) -> None:
    """Writes report.png beside this file."""
    page = (out / "report.html").read_text()
    style = "".join(f"{where}::after {_LOOK.format(note=note)}" for where, note in _NOTES.items())
    with tempfile.TemporaryDirectory() as folder:
        noted = Path(folder) / "report.html"
        noted.write_text(page.replace("</head>", f"<style>{style}</style></head>"))
        picture = Path(__file__).with_name("report.png")
        words = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--window-size={_WIDTH},{_HEIGHT}"]
        subprocess.run(["chromium", *words, f"--screenshot={picture}", noted.as_uri()], check=True, capture_output=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
