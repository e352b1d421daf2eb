"""Messages count one thing and several things, and notes say what was found of sensors."""

from __future__ import annotations

import pytest

from mqslam.core.wording import count_of, describe_times, is_or_are, join_words, list_sensor_notes


@pytest.mark.parametrize(("number", "text"), [(0, "0 scans are"), (1, "1 scan is"), (2, "2 scans are")])
def test_one_is_singular_and_all_else_plural(number: int, text: str) -> None:
    assert f"{count_of(number, 'scan')} {is_or_are(number)}" == text


def test_times_that_are_written_alike_are_one_time() -> None:
    assert describe_times(51.0, 51.04) == "at 51.0 s" and describe_times(51.0, 51.2) == "from 51.0 s to 51.2 s"
    assert describe_times(-0.01, 0.04) == "at 0.0 s"


USED = {"used": True, "statements": ["the sensor is used"]}
LEFT_OUT = {"used": False, "statements": ["it contradicts the radar"]}


@pytest.mark.parametrize(
    ("sensors", "status", "after", "named"),
    [
        ({"gyroscope": USED, "gnss": USED}, "warn", 0.26, "the gyroscope and GNSS"),
        ({"gyroscope": LEFT_OUT, "gnss": USED}, "fail", 0.26, "GNSS"),
        ({"gyroscope": None, "gnss": USED}, "pass", 0.26, None),
        ({"gyroscope": None, "gnss": USED}, "warn", 0.24, None),
        ({"gyroscope": LEFT_OUT, "gnss": None}, "fail", 0.26, None),
    ],
)
def test_a_map_that_is_not_passed_and_was_crisper_without_the_sensors_says_so(
    sensors: dict[str, object], status: str, after: float, named: str | None
) -> None:
    psi = {"per_point_odometry": 0.25, "per_point_optimised": after}
    notes = list_sensor_notes({"sensors": sensors, "psi": psi, "verdict": {"status": status}})
    doubts = [note for note in notes if note.startswith("psi per point is 0.2500 before optimisation")]
    assert len(doubts) == (named is not None)
    assert all(note.endswith(f"a run without {named}") for note in doubts)


def test_a_doppler_shift_that_was_measured_is_noted_and_one_that_was_stated_is_not() -> None:
    (note,) = list_sensor_notes({"doppler_beta": 0.0448, "doppler_sigma": 0.0062})
    assert note.startswith("the Doppler shift, as psi measured it, is 0.0448 ± 0.0062 m of range per m/s")
    assert list_sensor_notes({"doppler_beta": 0.049, "doppler_sigma": 0.0}) == []


def test_words_are_joined_as_a_sentence_lists_them() -> None:
    assert [join_words(list(words)) for words in ("", "a", "ab", "abc")] == ["", "a", "a and b", "a, b and c"]
