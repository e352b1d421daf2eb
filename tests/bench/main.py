"""The measurements of BENCHMARKS.md.

A benchmark prints its table and leaves it as JSON. The exit code is 1 if a figure misses its bound or has lost against
`baseline`: more than 5 % of its accuracy, or 25 % in a ratio of times. `--write` makes the results the new baseline, and
fills the pages from it.
"""

from __future__ import annotations

import argparse
import shutil
import traceback
from pathlib import Path

from bench.benchmark import MissingData
from bench.benchmarks import BENCHMARKS
from bench.pages import BASELINE, Result, make_result, write_pages
from bench.recordings import cache
from bench.timing import Took


def main() -> int:
    """Runs the benchmarks that the command line names, and returns the exit code."""
    parser = argparse.ArgumentParser(description="The measurements of BENCHMARKS.md.")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"one of {', '.join(BENCHMARKS)}; the short ones by default"
    )
    parser.add_argument("--all", action="store_true", help="run all, which takes ten hours; by default the short ones run")
    parser.add_argument("--write", action="store_true", help="make the results the new baseline, and fill the pages")
    parser.add_argument("--fill", action="store_true", help="fill the pages from the baseline, and measure nothing")
    parser.add_argument("--out", type=Path, default=None, help="folder for the results; in the cache by default")
    chosen = parser.parse_args()
    if chosen.fill:
        write_pages()
        return 0
    unknown = set(chosen.names) - set(BENCHMARKS)
    if unknown:
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(BENCHMARKS)}")
    out = (chosen.out or cache() / "out").resolve()
    failed: list[str] = []
    missed: list[str] = []
    lost: list[str] = []
    skipped: list[str] = []
    for name in chosen.names or [name for name, benchmark in BENCHMARKS.items() if chosen.all or not benchmark.study]:
        print(f"\n== {name}", flush=True)
        try:
            missed_here, lost_here = _run(name, out, write=chosen.write)
        except MissingData as missing:
            print(f"SKIPPED: {missing}")
            skipped.append(name)
            continue
        except Exception as error:  # the others go on, for an hour's work is not to be lost by one of them
            traceback.print_exc()
            failed.append(f"{name} failed: {error}")
            continue
        missed += missed_here
        lost += lost_here
    if chosen.write:
        write_pages()
    counts = f"{len(failed)} benchmarks failed, {len(missed)} bounds missed, {len(lost)} losses, {len(skipped)} skipped"
    print("", counts, *failed, *missed, *lost, sep="\n")
    return 1 if failed or missed or (lost and not chosen.write) else 0


def _run(name: str, out: Path, *, write: bool) -> tuple[list[str], list[str]]:
    """Runs a benchmark and returns the bounds it missed, and its losses against the baseline."""
    benchmark, before = BENCHMARKS[name], BASELINE / f"{name}.json"
    begin = Took.now()
    work = out / name
    if work.exists():
        shutil.rmtree(work)  # what an earlier measurement has left
    work.mkdir(parents=True)
    rows = benchmark.measure(work)
    result = make_result(name, benchmark, rows, Took.now().since(begin))
    print(benchmark.what, result.format({}), f"({result.describe_time()})", sep="\n\n", flush=True)
    lost = benchmark.find_losses(name, result.rows, Result.read(before).rows) if before.exists() else []
    missed = benchmark.find_missed(name, result.rows)
    worse = f"{len(lost)} of its figures are worse, which are called losses" if lost else "none of its figures is worse"
    print(f"Compared with the baseline: {worse}." if before.exists() else "There is no baseline to compare with.")
    print(*missed, *lost, sep="\n")
    result.write(out / f"{name}.json")
    if write:
        result.write(before)
    return missed, lost
