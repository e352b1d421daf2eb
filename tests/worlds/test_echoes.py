"""Echoes add up as complex amplitudes at their true distances."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from worlds.hard.echoes import WAVELENGTH, Beams, Echoes, add_echoes

AZIMUTHS, BINS, RESOLUTION = 400, 300, 0.175


def make_beams(**changes: Any) -> Beams:
    """Returns the beams of a radar that drives ahead at 10 m/s and turns left at 0.3 rad/s."""
    times = 0.25 * np.arange(AZIMUTHS) / AZIMUTHS
    headings = 0.3 * times - 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    usual = Beams(
        poses=np.column_stack([10.0 * times, np.zeros(AZIMUTHS), headings]),
        velocities=np.tile([10.0, 0.0], (AZIMUTHS, 1)),
        times=times,
        width=float(np.deg2rad(1.8)),
        foot=0.12,
        foot_widths=2.6,
        resolution=RESOLUTION,
        betas=np.zeros(AZIMUTHS),
    )
    return usual._replace(**changes)


def make_echoes(places: Any, amplitudes: Any, beams: Beams, velocities: Any = None) -> Echoes:
    """Returns echoes, each with the azimuth that looks at it most nearly."""
    places = np.array(places, dtype=float)
    velocities = np.zeros_like(places) if velocities is None else np.array(velocities, dtype=float)
    lines = places[:, None] + velocities[:, None] * beams.times[:, None] - beams.poses[:, :2]
    off = np.arctan2(lines[..., 1], lines[..., 0]) - beams.poses[:, 2]
    return Echoes(places, velocities, np.array(amplitudes, dtype=float), np.argmax(np.cos(off), axis=1))


def render(echoes: Echoes, beams: Beams) -> NDArray[np.complex128]:
    field = np.zeros((AZIMUTHS, BINS), dtype=np.complex128)
    add_echoes(echoes, beams, field)
    return field


def render_plainly(echoes: Echoes, beams: Beams) -> NDArray[np.complex128]:
    """Returns the field of echoes over all azimuths, however faint they are there."""
    field = np.zeros((AZIMUTHS, BINS), dtype=np.complex128)
    main = 0.6 * beams.width
    for place, velocity, amplitude in zip(echoes.places, echoes.velocities, echoes.amplitudes, strict=True):
        line = place + velocity * beams.times[:, None] - beams.poses[:, :2]
        r = np.hypot(*line.T)
        off = np.sin(np.arctan2(line[:, 1], line[:, 0]) - beams.poses[:, 2])
        ahead = np.cos(np.arctan2(line[:, 1], line[:, 0]) - beams.poses[:, 2]) > 0.0
        closing = np.sum((beams.velocities - velocity) * line, axis=1) / r
        gain = (1.0 - beams.foot) * np.exp(-((off / main) ** 2))
        gain += beams.foot * np.exp(-((off / main / beams.foot_widths) ** 2))
        at = (r - beams.betas * closing) / beams.resolution - 0.5
        b = np.floor(at).astype(int)
        echo = amplitude * gain * ahead * np.exp(4j * np.pi / WAVELENGTH * r)
        rows = np.arange(AZIMUTHS)
        field[rows, b] += (1.0 - at + b) * echo
        field[rows, b + 1] += (at - b) * echo
    return field


STILL = make_beams(poses=np.column_stack([np.zeros((AZIMUTHS, 2)), -2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS]))


@pytest.mark.parametrize("doppler_beta", [0.0, 0.05])
def test_the_kernel_adds_what_plain_arrays_add_down_to_the_faint(doppler_beta: float) -> None:
    rng = np.random.default_rng(1)
    bearings, ranges = rng.uniform(-np.pi, np.pi, 60), rng.uniform(4.0, 45.0, 60)
    places = ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
    beams = make_beams(betas=np.full(AZIMUTHS, doppler_beta))
    echoes = make_echoes(places, 10.0 ** rng.uniform(0.0, 3.0, 60), beams, rng.normal(0.0, 5.0, (60, 2)))
    plain = render_plainly(echoes, beams)
    np.testing.assert_allclose(render(echoes, beams), plain, atol=1.0, rtol=1e-6)  # a noise amplitude is 1.4
    assert np.abs(plain).max() > 300.0


def test_an_echo_lies_at_its_range_in_the_beam_that_meets_it() -> None:
    power = np.abs(render(make_echoes([[0.0, -20.0]], [100.0], STILL), STILL))
    row, b = np.unravel_index(np.argmax(power), power.shape)
    assert (row, b) == (100, round(20.0 / RESOLUTION - 0.5))
    assert power[:, b].astype(bool).sum() < 20


def test_two_scatterers_a_quarter_wave_apart_in_range_cancel_each_other() -> None:
    alone = np.abs(render(make_echoes([[20.0, 0.0]], [100.0], STILL), STILL)).max()
    against = np.abs(render(make_echoes([[20.0, 0.0], [20.0 + WAVELENGTH / 4.0, 0.0]], [100.0, 100.0], STILL), STILL)).max()
    along = np.abs(render(make_echoes([[20.0, 0.0], [20.0 + WAVELENGTH / 2.0, 0.0]], [100.0, 100.0], STILL), STILL)).max()
    assert against < 0.05 * alone and along > 1.95 * alone


def test_what_approaches_is_seen_too_near_by_its_speed_times_the_doppler_shift() -> None:
    def centre(doppler_beta: float) -> float:
        beams = make_beams(betas=np.full(AZIMUTHS, doppler_beta))
        power = np.abs(render(make_echoes([[20.0, 0.0]], [100.0], beams), beams))[0]
        return float(np.sum(np.arange(BINS) * power) / power.sum() * RESOLUTION)

    assert centre(0.0) - centre(0.1) == pytest.approx(1.0, abs=1e-6)
