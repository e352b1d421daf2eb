"""Nothing in a name from a file commands a terminal or turns the order of letters, wherever the name is shown."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import pytest

from mqslam.cli.terminal import Terminal, echo, format_verdict
from mqslam.errors import DataError, Remedy, show, show_lines
from mqslam.execution.files import to_json, write_text
from mqslam.results.files import format_log

HOSTILE = "/gps\x1b]0;PWNED\x07\x9b31m\r\u202egnp.\u2066\u200b\x7f[red]x[/blue]\ud800\nmqslam: all is well"
SHOWN = r"/gps\x1b]0;PWNED\x07\x9b31m\r\u202egnp.\u2066\u200b\x7f[red]x[/blue]\ud800\nmqslam: all is well"


def test_control_characters_are_escapes_and_others_stay() -> None:
    assert show(HOSTILE) == SHOWN and show_lines(HOSTILE) == SHOWN.replace(r"\n", "\n")
    assert show("ψ ± 3 °, Straße, 東京, é🚗") == "ψ ± 3 °, Straße, 東京, é🚗"
    assert show("a\tb") == r"a\tb" and show_lines("a\tb\r\nc\rd") == "a\tb\r\nc\\rd"


def test_errors_show_escapes() -> None:
    error = DataError(Path(HOSTILE), "is broken", Remedy.NAME_TOPIC)
    assert str(error) == SHOWN.replace(r"\n", " ") + ": is broken; name the radar's topic"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_the_terminal_shows_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal()
    terminal.print_notes([HOSTILE])
    terminal.print_warnings([HOSTILE])
    echo(HOSTILE)
    shown = capsys.readouterr()
    assert shown.err == f"note: {SHOWN}\nwarning: {SHOWN}\n" and shown.out == SHOWN.replace(r"\n", "\n") + "\n"
    verdict = {"status": "warn", "diagnosis": HOSTILE, "reasons": [HOSTILE, f"two: {HOSTILE}"]}
    shown = format_verdict({"verdict": verdict, "not_judged": [HOSTILE]})
    assert shown == [("verdict", f"warn: {SHOWN}"), ("because", f"two: {SHOWN}"), ("not judged", SHOWN)]


def test_files_hold_escapes(tmp_path: Path) -> None:
    write_text(tmp_path / "report.html", HOSTILE)
    assert (tmp_path / "report.html").read_text() == SHOWN.replace(r"\n", "\n")
    assert json.loads(to_json({"topic": HOSTILE}))["topic"] == SHOWN.replace(r"\n", "\n")
    assert SHOWN in format_log("run", [HOSTILE]).splitlines()
