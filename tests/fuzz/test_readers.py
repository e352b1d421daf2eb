"""Every reader on damaged inputs: a clear error or a sound read, in time and in little memory.

`MQSLAM_FUZZ=10000 pytest tests/fuzz` reads so many of each, all new ones; the usual few are the same every time.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from support.limits import within_limits
from support.mutation import CHANGES, Change
from support.subjects import SUBJECTS, Subject

from mqslam.errors import MqslamError

os.environ["RUST_BACKTRACE"] = "0"  # else a panic of lazrs, which is handled, loads 50 MB of symbols to print
INPUTS = int(os.environ.get("MQSLAM_FUZZ", "25"))


@pytest.mark.parametrize("name", SUBJECTS)
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_input_is_read_soundly_or_refused_clearly(tmp_path: Path, name: str) -> None:
    subject = SUBJECTS[name]
    path = subject.write(tmp_path)
    subject.read(path)  # valid as it is; and libraries are loaded before anything is measured
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    contents = {file: file.read_bytes() for file in files}

    @settings(
        max_examples=INPUTS,
        deadline=None,
        database=None,
        derandomize="MQSLAM_FUZZ" not in os.environ,
        suppress_health_check=list(HealthCheck),
    )
    @given(CHANGES)
    def fuzz(changes: list[Change]) -> None:
        damaged = dict(contents)
        for change in changes:
            damage(damaged, subject, change)
        for file in files:
            if damaged[file] != contents[file]:
                file.write_bytes(damaged[file])
        try:
            read(subject, path, sum(map(len, damaged.values())))
        finally:
            for file in files:
                if damaged[file] != contents[file]:
                    file.write_bytes(contents[file])

    fuzz()


def damage(contents: dict[Path, bytes], subject: Subject, change: Change) -> None:
    """Applies a change to one of the files."""
    file = list(contents)[change.which % len(contents)]
    mutations = subject.mutations(file)
    mutate = mutations[change.value % len(mutations)]
    try:
        contents[file] = mutate(contents[file], change)
    except Exception:  # an earlier change has broken what this one was to unpack
        contents[file] = mutations[0](contents[file], change)


def read(subject: Subject, path: Path, size: int) -> None:
    """Reads within the limits; an error must be one that is meant for users: a line or so, that names a file."""
    gc.collect(0)
    with within_limits(size):
        try:
            subject.read(path)
        except MqslamError as error:
            text = str(error)
            assert len(text) < 1000 and text.count("\n") == 0, text
            assert path.stem in text or path.name in text, text
