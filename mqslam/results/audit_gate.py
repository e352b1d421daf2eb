"""Writes an audit in the forms that build servers show, Markdown and JUnit's XML, and finds tests with worse results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from mqslam.auditing.verdict import GRAVEST_FIRST, VerdictStatus
from mqslam.core.wording import list_outcomes
from mqslam.errors import show
from mqslam.execution.files import write_bytes, write_text

_GRAVEST_FIRST = [status.value for status in GRAVEST_FIRST]


def list_worse(summary: Mapping[str, Any], baseline: Mapping[str, Any]) -> list[str]:
    """Returns one sentence for each status, of the verdict or of a test, that is worse than in an earlier audit.

    The sentence on the verdict comes first. The list is empty if no status is worse.

    Args:
        summary: content of audit.json.
        baseline: content of the audit.json of the earlier audit; tests that only one of the audits has are not compared.
    """
    now, before = ({"verdict": one["verdict"], **one["tests"]} for one in (summary, baseline))
    worse = []
    for name in now.keys() & before.keys():
        status, old = now[name]["status"], before[name]["status"]
        if _GRAVEST_FIRST.index(status) < _GRAVEST_FIRST.index(old):
            worse.append((list(now).index(name), f"{name} is {status} and was {old}"))
    return [sentence for _, sentence in sorted(worse)]


def write_gate(folder: Path, summary: Mapping[str, Any]) -> None:
    """Writes audit.md and junit.xml, the forms of an audit that build servers show.

    Args:
        folder: the existing folder of the audit's results.
        summary: content of audit.json.

    Raises:
        OutputError: a file cannot be written.
    """
    write_text(folder / "audit.md", format_markdown(summary))
    write_bytes(folder / "junit.xml", format_junit(summary))


def name_audited(summary: Mapping[str, Any]) -> str:
    """Returns as text the path and the layout of the audited data and, if there is one, the source of the trajectory.

    Args:
        summary: content of audit.json.
    """
    dataset, trajectory = summary["dataset"], summary["trajectory"]
    return f"{dataset['path']} ({dataset['format']}){'' if trajectory is None else f' under {trajectory}'}"


def format_markdown(summary: Mapping[str, Any]) -> str:
    """Returns audit.json as Markdown: verdict, data, notes, statuses that are worse than in an earlier audit, and tests.

    The notes are those of `list_outcomes`, the other notes of audit.json, and the warnings.
    """
    verdict, baseline = summary["verdict"], summary.get("baseline")
    blocks = [[f"## mqslam audit: {verdict['status']}"], [_plain(verdict["diagnosis"])]]
    blocks.append([f"Audited: {_plain(name_audited(summary))}"])
    outcomes = [text for _, text in list_outcomes(summary)]
    notes = dict.fromkeys([*outcomes, *summary.get("notes", []), *summary.get("warnings", [])])
    blocks += [[f"- {_plain(note)}" for note in notes]] if notes else []
    if baseline is not None:
        what = "this is worse:" if baseline["worse"] else "nothing is worse."
        blocks += [[f"Compared with {_plain(baseline['path'])}, {what}"]]
        blocks += [[f"- {_plain(sentence)}" for sentence in baseline["worse"]]] if baseline["worse"] else []
    rows = [(name, test["status"], _plain("; ".join(test["reasons"]))) for name, test in summary.get("tests", {}).items()]
    blocks.append(["| test | status | finding |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)])
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _plain(text: str) -> str:
    """Escapes all characters in a text that could be Markdown or HTML, since parts of the text come from users."""
    return "".join(f"\\{c}" if c in "\\`*_[]|<>#" else c for c in show(text))


def format_junit(summary: Mapping[str, Any]) -> bytes:
    """Returns the content of audit.json as JUnit's XML, with one test case for each test and one for the verdict.

    A case fails if its status is `fail` or is worse than in the earlier audit; else a case that was not judged is skipped.
    """
    baseline = summary.get("baseline")
    worse = {} if baseline is None else {sentence.split(" is ")[0]: sentence for sentence in baseline["worse"]}
    cases = []
    for name, test in {**summary.get("tests", {}), "verdict": summary["verdict"]}.items():
        case = ElementTree.Element("testcase", classname="mqslam.audit", name=name)
        text = show("; ".join([*([worse[name]] if name in worse else []), *test["reasons"]]))
        if test["status"] == VerdictStatus.FAIL or name in worse:
            ElementTree.SubElement(case, "failure", message=text)
        elif test["status"] == VerdictStatus.NOT_JUDGED:
            ElementTree.SubElement(case, "skipped", message=text)
        else:
            ElementTree.SubElement(case, "system-out").text = text
        cases.append(case)
    counts = {kind: str(sum(case.find(tag) is not None for case in cases)) for kind, tag in _COUNTED.items()}
    suite = ElementTree.Element("testsuite", {"name": "mqslam audit", "tests": str(len(cases)), **counts})
    suite.extend(cases)
    ElementTree.indent(suite)
    return bytes(ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)) + b"\n"


_COUNTED = {"failures": "failure", "skipped": "skipped"}
