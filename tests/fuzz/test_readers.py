"""Every reader on damaged inputs: a clear error or a sound read, in time and in little memory.

`MQSLAM_FUZZ=10000 MQSLAM_FUZZ_NEW=1 pytest tests/fuzz` reads so many of each, all of them drawn anew.
"""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest
from support.fuzzing import INPUTS, Outcome, fuzz
from support.limits import within_limits
from support.subjects import SUBJECTS, Subject

from mqslam.errors import MqslamError

os.environ["RUST_BACKTRACE"] = "0"  # else a panic of lazrs, which is handled, loads 50 MB of symbols to print
OF_PROCESSES = 40  # a reader with a process of its own takes so many times as long


@pytest.mark.parametrize("name", SUBJECTS)
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_input_is_read_soundly_or_refused_clearly(tmp_path: Path, name: str) -> None:
    subject = SUBJECTS[name]
    path = subject.write(tmp_path)
    subject.read(path)  # valid as it is; and libraries are loaded before anything is measured
    inputs = -(-INPUTS // OF_PROCESSES) if subject.is_apart else INPUTS
    fuzz(name, path, subject.mutations, lambda size: read(subject, path, size), inputs)


def read(subject: Subject, path: Path, size: int) -> Outcome:
    """Reads within the limits; an error must be one that is meant for users: a line or so, that names a file."""
    gc.collect(0)
    refused = False
    with within_limits(size) as cost:
        try:
            subject.read(path)
        except MqslamError as error:
            refused = True
            text = str(error)
            assert len(text) < 1000 and text.count("\n") == 0, text
            assert path.stem in text or path.name in text, text
    return Outcome(refused, cost)
