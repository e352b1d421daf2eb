"""Builds the source distribution and a wheel from it, and tries both in clean environments: `make dist`.

Every Python that the classifiers in pyproject.toml name gets an environment of its own, without extras. Where no such
interpreter is on this machine, that is said, and it is still checked that wheels of all dependencies exist for it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST_MB = 800  # what an environment without extras may take on disk
DRIVE = ("--duration", "5", "--azimuths", "200", "--range-resolution", "0.35", "--max-range", "60", "--movers", "0")
PIP = ("-m", "pip", "--quiet", "--disable-pip-version-check")


class Failure(Exception):
    """A distribution that does not do what it should."""


def main() -> int:
    """Builds both distributions, tries them, and returns the exit code."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mqslam-dist-") as scratch:
        try:
            sdist, wheel = build(ROOT / "dist")
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                tries = [pool.submit(try_python, v, wheel, sdist, Path(scratch, v)) for v in list_versions()]
                for outcome in tries:
                    print(outcome.result(), flush=True)
        except Failure as failure:
            print(f"make dist: {failure}", file=sys.stderr)
            return 1
    print(f"make dist: {sdist.name} and {wheel.name} lie in dist/ ({time.monotonic() - begin:.0f} s)")
    return 0


def build(folder: Path) -> tuple[Path, Path]:
    """Builds the source distribution, and the wheel from what it holds, which is outside of git."""
    shutil.rmtree(folder, ignore_errors=True)
    call([sys.executable, "-m", "build", "--outdir", folder, ROOT], ROOT)
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return sdist, wheel


def list_versions() -> list[str]:
    """Lists the versions of Python that the classifiers name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [name.rpartition(" ")[2] for name in project["classifiers"] if re.search(r":: 3\.\d+$", name)]


def find_python(version: str) -> Path | None:
    """Finds an interpreter of a version on the path, or among pyenv's, whose stubs on the path may refuse to start."""
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    known = [Path(sys.executable), *(Path(path) for path in [shutil.which(f"python{version}")] if path)]
    known += sorted((root / "versions").glob(f"{version}.*/bin/python{version}"))
    code = "import ensurepip, sys, venv; print('.'.join(map(str, sys.version_info[:2])))"
    for python in known:
        shown = subprocess.run([python, "-c", code], capture_output=True, text=True)
        if shown.returncode == 0 and shown.stdout.strip() == version:
            return python
    return None


def try_python(version: str, wheel: Path, sdist: Path, scratch: Path) -> str:
    """Tries both distributions with a version of Python, and returns what was found."""
    scratch.mkdir()
    interpreter = find_python(version)
    if interpreter is None:
        wanted = ["--dry-run", "--target", scratch / "none", "--python-version", version, "--only-binary", ":all:"]
        call([sys.executable, *PIP, "install", *wanted, wheel], scratch)
        return f"Python {version}: skipped, no interpreter of it is here; wheels of all that mqslam needs exist for it"
    call([interpreter, "-m", "venv", "env"], scratch)
    python = scratch / "env" / "bin" / "python"
    call([python, *PIP, "install", wheel], scratch)
    taken = measure_mb(scratch / "env")
    if taken > MOST_MB:
        raise Failure(f"Python {version}: an environment without extras takes {taken:.0f} MB, more than {MOST_MB}")
    try_commands(scratch)
    name_missing(scratch)
    call([python, *PIP, "install", "--no-deps", "--force-reinstall", sdist], scratch)
    mqslam(scratch, "run", "drive", "--out", "again", "--frontend", "odometry")
    return f"Python {version}: run, audit and compare work; without extras the environment takes {taken:.0f} MB"


def try_commands(scratch: Path) -> None:
    """Runs what must work without extras, and checks that each command leaves its report."""
    mqslam(scratch, "simulate", "drive", *DRIVE)
    mqslam(scratch, "run", "drive", "--out", "result")
    mqslam(scratch, "audit", "drive", "--trajectory", "result/trajectory.tum", "--out", "audited")
    mqslam(scratch, "compare", "drive", "--frontends", "psi,kiss_icp", "--out", "compared")
    for folder in ("result", "audited", "compared"):
        if not (scratch / folder / "report.html").is_file():
            raise Failure(f"{scratch.name}: {folder} has no report")


def name_missing(scratch: Path) -> None:
    """Checks that each command that needs an extra names it."""
    (scratch / "cloud.pcd").write_text("# .PCD v0.7\n")
    words_by_extra = {
        "open3d": ("compare", "drive", "--frontends", "open3d_icp", "--out", "without-open3d"),
        "clouds": ("audit", "cloud.pcd", "--trajectory", "result/trajectory.tum", "--out", "without-clouds"),
        "view": ("view", "result", "--rerun"),
        "cluster": ("run", "drive", "--out", "without-cluster", "--cluster", "local:2"),
    }
    for extra, words in words_by_extra.items():
        shown = mqslam(scratch, *words, code=2)
        if f"[{extra}]'" not in shown.stderr or "pip install" not in shown.stderr:
            raise Failure(f"{scratch.name}: mqslam {' '.join(words)} does not name the extra {extra}:\n{shown.stderr}")


def mqslam(scratch: Path, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Runs a command of the installed mqslam."""
    return call([scratch / "env" / "bin" / "mqslam", *words], scratch, code)


def call(words: Sequence[str | Path], folder: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    """Runs a command in a folder, without this shell's Python paths, and checks its exit code."""
    bare = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run([*map(str, words)], cwd=folder, env=bare, capture_output=True, text=True)
    if done.returncode != code:
        raise Failure(f"{' '.join(map(str, words))} ended with {done.returncode}, not {code}:\n{done.stdout}{done.stderr}")
    return done


def measure_mb(folder: Path) -> float:
    """Returns what a folder takes on disk [MB of 2^20 bytes], as `du -sm` does."""
    return sum(path.lstat().st_blocks * 512 for path in folder.rglob("*")) / 2**20


if __name__ == "__main__":
    sys.exit(main())
