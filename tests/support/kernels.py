"""Compile every kernel once, before several processes run the tests and each would compile them for itself.

usage: python -m support.kernels, with tests on the path
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from support.commands import mqslam
from worlds.writing import simulate_hard


def main() -> None:
    """Simulates hard radar and runs commands on a short drive, which together call all kernels; numba keeps the results."""
    with tempfile.TemporaryDirectory() as folder:
        simulate_hard(Path(folder) / "hard", scene="city", duration_s=1.0)
        drive, out, quick = (Path(folder) / name for name in ("drive", "out", "quick.yaml"))
        quick.write_text("sensor: {doppler_beta: 0.0}\n")
        for words in (
            ["simulate", drive, "--duration", 2, "--azimuths", 100, "--movers", 1],
            ["run", drive, "--out", out, "--config", quick],
            ["audit", drive, "--trajectory", out / "trajectory.tum", "--out", Path(folder) / "audited", "--config", quick],
            ["score", drive, "--start", 0, "--motion", "8,0"],
        ):
            shown = mqslam(*words, "--quiet")
            if shown.code != 0:
                sys.exit(shown.err)


if __name__ == "__main__":
    main()
