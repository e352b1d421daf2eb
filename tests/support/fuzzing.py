"""The harness of the fuzz tests: damages files in place, has something done with them, and puts them back."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from support.limits import Cost
from support.mutation import CHANGES, Change, Mutate

INPUTS = int(os.environ.get("MQSLAM_FUZZ", "25"))
NEW = os.environ.get("MQSLAM_FUZZ_NEW") == "1"  # whether inputs are drawn anew; otherwise they are the same every time
TABLE = os.environ.get("MQSLAM_FUZZ_TABLE")  # a file to which a row is added for each of what was fuzzed


@dataclass(frozen=True)
class Outcome:
    """Whether a damaged input was refused, and what it cost to find out."""

    refused: bool
    cost: Cost


def fuzz(
    name: str, path: Path, mutations: Callable[[Path], tuple[Mutate, ...]], act: Callable[[int], Outcome], inputs: int
) -> None:
    """Does something with a file, or the files of a folder, as many times as there are inputs, each damaged in another way.

    Args:
        name: what is fuzzed.
        path: the file or folder.
        mutations: the kinds of damage to a file.
        act: is given the number of bytes of the damaged files.
        inputs: how many times.
    """
    outcomes: list[Outcome] = []
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    contents = {file: file.read_bytes() for file in files}

    @settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        derandomize=not NEW,
        suppress_health_check=list(HealthCheck),
    )
    @given(CHANGES)
    def damage_and_act(changes: list[Change]) -> None:
        damaged = dict(contents)
        for change in changes:
            _damage(damaged, mutations, change)
        changed = [file for file in files if damaged[file] != contents[file]]
        for file in changed:
            file.write_bytes(damaged[file])
        try:
            outcomes.append(act(sum(map(len, damaged.values()))))
        finally:
            for file in changed:
                file.write_bytes(contents[file])

    damage_and_act()
    if TABLE is not None:
        refused, costs = sum(outcome.refused for outcome in outcomes), [outcome.cost for outcome in outcomes]
        slowest, largest = max(cost.seconds for cost in costs), max(cost.megabytes for cost in costs)
        with Path(TABLE).open("a", encoding="utf-8") as file:
            cells = name, len(outcomes), refused, len(outcomes) - refused, f"{slowest:.2f}", f"{largest:.0f}"
            file.write(f"| {' | '.join(map(str, cells))} |\n")


def _damage(contents: dict[Path, bytes], mutations: Callable[[Path], tuple[Mutate, ...]], change: Change) -> None:
    """Applies a change to one of the files."""
    file = list(contents)[change.which % len(contents)]
    kinds = mutations(file)
    mutate = kinds[change.value % len(kinds)]
    try:
        contents[file] = mutate(contents[file], change)
    except Exception:  # an earlier change has broken what this one was to unpack
        contents[file] = kinds[0](contents[file], change)
