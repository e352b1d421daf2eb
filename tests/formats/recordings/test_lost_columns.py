"""Azimuths that a recorder lost are found in the images, and the others are put where they belong."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mqslam.errors import DataError
from mqslam.formats.recordings.lost_columns import Restorer, count_lost

Image = NDArray[np.uint8]
ROWS, AZIMUTHS, TURNS = 128, 200, 7


def drive_past(seed: int, speed: float) -> list[Image]:
    """Renders turns of a radar that drives straight on, so that the scene shifts along range and azimuth.

    Args:
        seed: of the scene and of its speckle.
        speed: largest shift from one turn to the next [columns, and rows].
    """
    rng = np.random.default_rng(seed)
    scene = np.clip(rng.gamma(1.0, 20.0, (ROWS, AZIMUTHS)), 0, 200)
    scene = (scene + np.roll(scene, 1, axis=1)) / 2.0  # the beam is wider than a step
    nearness = np.linspace(1.0, 0.3, ROWS)[:, None]
    bearings = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    images = []
    for turn in range(TURNS):
        driven = speed * (turn - TURNS // 2)
        columns = np.arange(AZIMUTHS) + driven * nearness * np.sin(bearings)
        rows = np.arange(ROWS)[:, None] + driven * np.cos(bearings)
        seen = scene[np.round(rows).astype(int) % ROWS, np.round(columns).astype(int) % AZIMUTHS]
        speckled = seen * rng.gamma(6.0, 1.0 / 6.0, scene.shape)
        images.append(np.clip(speckled, 0, 255).astype(np.uint8))
    return images


def record(images: Sequence[Image], lost: dict[int, list[int]]) -> list[Image]:
    """Returns images as a recorder leaves them that loses some azimuths of some turns, and reuses its buffer."""
    buffer, recorded = np.zeros((ROWS, AZIMUTHS), dtype=np.uint8), []
    for turn, image in enumerate(images):
        kept = np.delete(image, lost.get(turn, []), axis=1)
        buffer[:, : kept.shape[1]] = kept
        recorded.append(buffer.copy())
    return recorded


def restorer_of(images: Sequence[Image | None]) -> Restorer:
    """Returns what restores images, of which some cannot be read."""

    def read(k: int) -> Image:
        image = images[k]
        if image is None:
            raise DataError(Path(f"{k}.png"), "is damaged", "copy it anew")
        return image

    return Restorer(read, len(images))


@given(seed=st.integers(0, 10_000), speed=st.floats(0.0, 4.0), place=st.integers(0, AZIMUTHS - 1))
def test_a_lost_azimuth_is_counted_and_the_others_are_kept(seed: int, speed: float, place: int) -> None:
    images = drive_past(seed, speed)
    recorded = record(images, {3: [place]})
    assert [count_lost(*pair) for pair in itertools.pairwise(recorded)] == [0, 0, 1, 0, 0, 0]
    restored, measured = restorer_of(recorded).restore(3)
    found = int(np.flatnonzero(~measured)[0])
    assert not restored[:, found].any()
    azimuths = np.arange(AZIMUTHS)
    right = (azimuths < min(found, place)) | (azimuths > max(found, place))
    assert np.array_equal(restored[:, right], images[3][:, right])


@pytest.mark.parametrize("speed", [0.0, 1.0, 2.0])
def test_the_place_of_a_lost_azimuth_is_found(speed: float) -> None:
    places = np.random.default_rng(0).integers(0, AZIMUTHS, 20).tolist()
    errors = []
    for seed, place in enumerate(places):
        recorded = record(drive_past(seed, speed), {3: [place]})
        _, measured = restorer_of(recorded).restore(3)
        errors.append(abs(int(np.flatnonzero(~measured)[0]) - place))
    assert np.median(errors) <= 5
    assert np.mean(errors) <= 0.1 * AZIMUTHS  # chance makes a third of a turn


def test_losses_of_turns_in_a_row_are_told_apart() -> None:
    errors = []
    for seed in range(6):
        lost = {2: [40], 3: [90, 150], 4: [20]}
        recorded = record(drive_past(seed, 1.0), lost)
        restorer = restorer_of(recorded)
        for turn in range(1, TURNS - 1):
            _, measured = restorer.restore(turn)
            found = np.flatnonzero(~measured)
            assert len(found) == len(lost.get(turn, []))
            errors += np.abs(found - lost.get(turn, [])).tolist()
    assert np.median(errors) <= 6


@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_whole_turns_stay_as_they_are(speed: float) -> None:
    images = drive_past(8, speed)
    restorer = restorer_of(images)
    for turn, image in enumerate(images):
        restored, measured = restorer.restore(turn)
        assert measured.all()
        assert np.array_equal(restored, image)


def test_images_that_repeat_have_lost_nothing() -> None:
    image = drive_past(1, 0.0)[0]
    assert count_lost(image, image) == 0
    assert count_lost(np.zeros_like(image), np.zeros_like(image)) == 0


def test_losses_are_spread_evenly_where_an_image_beside_is_missing() -> None:
    recorded = record(drive_past(2, 2.0), {3: [10]})
    beside: list[Image | None] = [*recorded]
    beside[4] = None
    _, measured = restorer_of(beside).restore(3)
    assert np.flatnonzero(~measured).tolist() == [AZIMUTHS // 2]


def test_a_turn_that_lost_very_many_azimuths_is_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search takes memory and time by the square of the number of lost azimuths."""
    monkeypatch.setattr("mqslam.formats.recordings.lost_columns.place_losses", None)
    images = [np.random.default_rng(turn).integers(0, 255, (2 * AZIMUTHS, AZIMUTHS), np.uint8) for turn in range(3)]
    kept = AZIMUTHS * 3 // 5
    images[1] = np.column_stack([images[1][:, :kept], images[0][:, kept:]])
    _, measured = restorer_of(images).restore(1)
    assert np.count_nonzero(~measured) == AZIMUTHS - kept


def test_the_result_does_not_depend_on_where_reading_begins() -> None:
    recorded = record(drive_past(9, 2.0), {1: [30], 2: [100], 3: [60], 4: [11, 12], 5: [150]})
    whole = restorer_of(recorded)
    for turn in range(TURNS):
        alone = restorer_of(recorded).restore(turn)
        assert np.array_equal(whole.restore(turn)[0], alone[0])
