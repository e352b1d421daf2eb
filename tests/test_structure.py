"""The package keeps the shape that CONTRIBUTING describes; import-linter and ruff hold what they can, this the rest."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mqslam"
PARTS = [PACKAGE, ROOT / "factors", ROOT / "frontends"]
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


def modules() -> list[Path]:
    """Returns all modules of the package."""
    return [path for part in PARTS for path in part.rglob("*.py")]


def test_no_test_file_is_long() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "tests").rglob("*.py")}
    assert {str(path): length for path, length in lengths.items() if length > 400} == {}


def test_only_the_command_line_names_options() -> None:
    named = {
        f"{path.relative_to(ROOT)}: {option}"
        for path in modules()
        if "cli" not in path.parts
        for line in path.read_text(encoding="utf-8").splitlines()
        for option in OPTION.findall(line)
        if not line.lstrip().startswith(("#", '"""')) or "mqslam" in line
    }
    assert named == set()


@pytest.mark.parametrize("heavy", ["numpy", "gtsam", "scipy"])
def test_settings_are_read_without_heavy_libraries(heavy: str) -> None:
    code = f"import mqslam.config, sys; sys.exit('{heavy}' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
