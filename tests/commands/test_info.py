from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.recordings import START_US, TURN_US, write_oxford

from mqslam.commands.info import describe_radar
from mqslam.formats.recordings import open_recording


def test_a_recording_is_described_in_plain_values(oxford: Path) -> None:
    end = START_US + 6 * TURN_US
    (oxford / "odom.csv").write_text(f"t,v,omega\n{START_US},2,0\n{end},2,0\n")
    description = describe_radar(open_recording(oxford, range_resolution=0.1))
    assert json.loads(json.dumps(description)) == {
        "format": "oxford",
        "path": str(oxford),
        "revolutions": 6,
        "duration_s": pytest.approx(1.5),
        "turn_rate_hz": pytest.approx(4.0),
        "azimuths": 40,
        "bins": 200,
        "range_resolution_m": 0.1,
        "max_range_m": pytest.approx(20.0),
        "odometry": {"poses": 2, "length_m": pytest.approx(3.0)},
        "ground_truth": None,
        "gyroscope": None,
        "gnss": None,
        "mount": None,
        "gaps": [],
        "notes": [],
        "faults": [],
    }


def test_gaps_are_described_by_place_and_length(tmp_path: Path) -> None:
    description = describe_radar(open_recording(write_oxford(tmp_path / "drive", polar_scans=9, skip=(4, 5))))
    assert description["revolutions"] == 7
    assert description["gaps"] == [{"after_revolution": 3, "missing_s": pytest.approx(0.5)}]
