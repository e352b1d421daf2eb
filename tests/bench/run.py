"""Runs benchmarks: `.venv/bin/python tests/bench/run.py --help`."""

import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # where the tests, too, find the package `bench`

from bench.main import main  # noqa: E402 - it is found only now

if __name__ == "__main__":
    sys.exit(main())
