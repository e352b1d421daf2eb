"""The measurements of BENCHMARKS.md.

usage: run.py [NAME ...] [--out DIR]
The names are startup, speed, table1, oxford, nees, drift, audit, full and cluster; without a name all of them are run.
Exits with 1 if a claim is missed. Generated data lie in $MQSLAM_BENCH_CACHE, by default a folder for temporary files.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from pathlib import Path

from common import MissingData, cache

NAMES = ("startup", "speed", "table1", "oxford", "nees", "drift", "audit", "full", "cluster")


def main() -> int:
    parser = argparse.ArgumentParser(description="The measurements of BENCHMARKS.md.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(NAMES)}; all by default")
    parser.add_argument("--out", type=Path, default=None, help="folder for plots and results; the cache by default")
    chosen = parser.parse_args()
    unknown = set(chosen.names) - set(NAMES)
    if unknown:
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    out = chosen.out or cache() / "out"
    out.mkdir(parents=True, exist_ok=True)
    missed, skipped = [], []
    for name in chosen.names or NAMES:
        begin = time.monotonic()
        print(f"\n== {name}", flush=True)
        try:
            claims = importlib.import_module(name).run(out)
        except MissingData as missing:
            print(f"SKIPPED: {missing}")
            skipped.append(name)
            continue
        print(*claims, sep="\n")
        print(f"({time.monotonic() - begin:.0f} s)", flush=True)
        missed += [claim for claim in claims if not claim.kept]
    print(f"\n{len(missed)} claims missed, {len(skipped)} benchmarks skipped", *missed, sep="\n")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
