"""Charts as SVG that stands in a page itself: their words can be searched, copied and read aloud, and they print sharp."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEGIN: Final = b"<svg"
_NOT_SHOWN: Final = re.compile(  # what a page does without, or what would act on all of it
    r'<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->| xmlns(?::\w+)?="[^"]*"| version="[^"]*"', re.DOTALL
)
_NAMED_GROUP: Final = re.compile(r'<g id="[^"]*">')  # the names repeat from chart to chart, and nothing refers to them
_SIZE: Final = re.compile(r'<svg(.*?) width="[^"]*"(.*?)>', re.DOTALL)
_HEIGHT: Final = re.compile(r'(<svg[^>]*?) height="[^"]*"')
_BLANK: Final = re.compile(r"\s*\n\s*")
_FONT: Final = re.compile(r"(font(?:-family)?: [^';\"]*)'[^;\"]*")


def encode_svg(figure: Figure) -> bytes:
    """Returns a figure as an SVG element for a page, transparent and as wide as its place there.

    Args:
        figure: a chart without pictures in it.
    """
    import matplotlib as mpl

    file = io.BytesIO()
    # words stay words, and the names of parts depend on nothing but what the parts show
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "mqslam"}):
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = file.getvalue().decode("utf-8")
    text = _NOT_SHOWN.sub("", text[text.index(_BEGIN.decode()) :])
    text = _HEIGHT.sub(r"\1", _SIZE.sub(r"<svg\1\2>", text, count=1), count=1)
    text = _FONT.sub(r"\1sans-serif", _NAMED_GROUP.sub("<g>", text))
    return _BLANK.sub("\n", text).strip().encode("utf-8")


def is_svg(picture: bytes) -> bool:
    """Returns whether a picture is an SVG element rather than a PNG file."""
    return picture.startswith(_BEGIN)
