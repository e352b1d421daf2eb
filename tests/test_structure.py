"""The package keeps the shape that CONTRIBUTING describes; import-linter and ruff hold what they can, this the rest."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "mqslam"
PARTS = [PACKAGE, ROOT / "factors", ROOT / "frontends"]
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


def entries(folder: Path) -> list[str]:
    """Returns the names of the files and folders that a folder holds."""
    return [path.name for path in folder.iterdir() if path.name != "__pycache__"]


def modules() -> list[Path]:
    """Returns all modules of the package."""
    return [path for part in PARTS for path in part.rglob("*.py")]


def test_no_folder_is_crowded() -> None:
    assert len(entries(PACKAGE)) <= 26
    folders = {path.parent for path in modules()} - {PACKAGE}
    assert {str(folder): len(entries(folder)) for folder in folders if len(entries(folder)) > 15} == {}


def test_the_method_fits_on_a_screen() -> None:
    assert len((PACKAGE / "slam.py").read_text(encoding="utf-8").splitlines()) < 165


def test_no_test_file_is_long() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in (ROOT / "tests").rglob("*.py")}
    assert {str(path): length for path, length in lengths.items() if length > 400} == {}


def test_no_two_modules_share_a_name() -> None:
    """Other than those of the commands, each of which has a function to call and words to print."""
    names = [path.stem for path in modules() if "cli" not in path.parts and path.stem != "__init__"]
    assert [name for name, count in Counter(names).items() if count > 1] == []


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
