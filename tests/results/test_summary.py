"""What a run's summary says happened."""

from types import SimpleNamespace

import numpy as np
import pytest

from mqslam.config import Config
from mqslam.results.summary import parked


@pytest.mark.parametrize(("standing_s", "said"), [(60.0, [(5.0, 65.25)]), (5.0, [])])
def test_a_long_stop_is_named_and_a_short_one_is_not(standing_s, said):
    driving = np.arange(0.0, 50.0, 2.5)
    stop = np.full(int(standing_s * 4.0), driving[-1]) + 0.01 * np.sin(np.arange(int(standing_s * 4.0)))
    x = np.concatenate([driving, stop, driving[-1] + 2.5 + driving])
    times = 0.25 * np.arange(len(x))
    run = SimpleNamespace(optimised=SimpleNamespace(poses=np.c_[x, np.zeros((len(x), 2))]), config=Config())
    recording = SimpleNamespace(start_times=times, duration_s=times[-1] + 0.25)
    found = parked(run, recording)
    assert len(found) == len(said)
    for span, expected in zip(found, said, strict=True):
        assert span == pytest.approx(expected, abs=0.6)
