"""Makes the pages that the program itself knows best, its command line and its settings, and sets equations.

Equations become MathML, which browsers show by themselves, so that nothing is fetched from elsewhere.
"""

from __future__ import annotations

import html
import re
import subprocess
import sys
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from mqslam.config import Config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the generated pages to those that are written by hand."""
    for name, text in (("reference/cli.md", describe_commands()), ("reference/settings.md", describe_settings())):
        files.append(File.generated(config, name, content=text))
    return files


def describe_commands() -> str:
    """Returns the page of the command line, as typer writes it."""
    command = [sys.executable, "-m", "typer", "mqslam.cli", "utils", "docs", "--name", "mqslam", "--title", "Command line"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def describe_settings() -> str:
    """Returns the page of all settings: a table for each section."""
    lines = ["# Settings", "", "`mqslam config show --all` prints these as YAML, and a file states only what differs.", ""]
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
        values = section.model_dump(mode="json")
        for key, field in kind.model_fields.items():
            description = " ".join((field.description or "").split()).replace("|", "\\|")
            lines.append(f"| `{key}` | `{values[key]}` | {description} |")
        lines.append("")
    return "\n".join(lines)


def on_page_content(content: str, **_: Any) -> str:
    """Returns the content of a page with its equations set."""

    def set_equation(match: re.Match[str]) -> str:
        display = "block" if match[2] == "[" else "inline"
        return f'<{match[1]} class="arithmatex">{convert(html.unescape(match[3]).strip(), display=display)}</{match[1]}>'

    return re.sub(r'<(div|span) class="arithmatex">\\([\[(])(.*?)\\[\])]</\1>', set_equation, content, flags=re.DOTALL)
