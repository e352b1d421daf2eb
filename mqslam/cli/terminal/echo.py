"""Lines on stdout."""

from __future__ import annotations

import typer

from mqslam.errors.shown import show_lines


def echo(text: str, *, end: str = "\n") -> None:
    """Prints lines in which nothing from a file can command the terminal."""
    typer.echo(show_lines(text) + end, nl=False)
