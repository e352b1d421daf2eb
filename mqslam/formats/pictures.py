"""Encodes figures as PDF, PNG or SVG, to the same bytes for the same data."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEFT_OUT: Final = {  # metadata that would differ between two drawings of the same data, by the form of the file
    ".pdf": ("CreationDate", "Creator", "Producer"),
    ".png": ("Software",),
    ".svg": ("Date", "Creator"),
}
SUFFIXES: Final = tuple(_LEFT_OUT)
"""The forms in which a figure can be encoded."""


def encode_figure(figure: Figure, suffix: str, dpi: int, **look: Any) -> bytes:
    """Returns a figure as the content of a file.

    Words stay text instead of outlines, and ids depend on the content only, so that the same data give the same bytes.

    Args:
        figure: the figure.
        suffix: form of the file, one of `SUFFIXES`.
        dpi: pixels per inch.
        look: further arguments of matplotlib's `savefig`.
    """
    import matplotlib as mpl

    file = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "mqslam", "pdf.fonttype": 42}):
        figure.savefig(file, format=suffix[1:], dpi=dpi, metadata=dict.fromkeys(_LEFT_OUT[suffix]), **look)
    return file.getvalue()
