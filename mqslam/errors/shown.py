"""Texts that hold names from files: what would command a terminal or turn the order of letters is shown as an escape."""

from __future__ import annotations

import re

_COMMANDS = r"\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ufff9-\ufffb\ud800-\udfff"
"""Control characters, those without width, those of direction, and bytes of a path that are no UTF-8."""
_IN_LINE = re.compile(f"[\\t\\n{_COMMANDS}]")
_IN_TEXT = re.compile(f"(?!\\r\\n)[{_COMMANDS}]")


def show(name: str) -> str:
    """Returns a text in one line, fit to be shown."""
    return _IN_LINE.sub(_escape, name)


def show_lines(text: str) -> str:
    """Returns a text of lines, fit to be shown."""
    return _IN_TEXT.sub(_escape, text)


def _escape(match: re.Match[str]) -> str:
    """Returns a character as Python writes it in a text."""
    return match[0].encode("unicode_escape").decode("ascii")
