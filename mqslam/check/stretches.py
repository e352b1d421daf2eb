"""A few short stretches of a recording, read and detected: all that the checks look at besides stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mqslam.artefacts import drop_fixed
from mqslam.config import Config
from mqslam.detection import revolutions_or_errors
from mqslam.detector import detect
from mqslam.errors import DataError
from mqslam.returns import Returns, Window
from mqslam.stream import RadarStream, Revolution
from mqslam.trajectory import Trajectory

STRETCHES = 3
REVOLUTIONS = 12


@dataclass(frozen=True, slots=True)
class Sweep:
    """How one revolution was swept.

    Args:
        azimuths: how many there are.
        unmeasured: how many of them are marked as not measured.
        turned: angle from the first azimuth to one step after the last [rad].
        step: usual step between neighbouring azimuths [rad].
        widest: widest one [rad].
        turn_s: how long its turn takes [s].
        span_s: from the first azimuth's time to the last one's [s].
        late_s: by how much its last azimuth comes after the next revolution's start [s], 0 where it does not.
        repeated: whether its power is that of the revolution before, byte by byte.
    """

    azimuths: int
    unmeasured: int
    turned: float
    step: float
    widest: float
    turn_s: float
    span_s: float
    late_s: float
    repeated: bool


@dataclass(frozen=True, slots=True)
class Stretch:
    """Successive revolutions without a gap.

    Args:
        windows: their returns.
        sweeps: how each was swept that could be read.
        unread: why the others could not be; their windows hold no returns.
    """

    windows: tuple[Window, ...]
    sweeps: tuple[Sweep, ...]
    unread: tuple[str, ...]


def read_stretches(
    stream: RadarStream, odometry: Trajectory | None, config: Config, progress: Callable[[int, int], None]
) -> list[Stretch]:
    """Read the stretches that tell most: where odometry's yaw rate changes most, or else spread over the recording.

    Args:
        stream: the recording.
        odometry: of the same clock, or None.
        config: all settings.
        progress: called with (revolutions read, revolutions in all).
    """
    spans = _spans(stream, odometry)
    total = sum(end - begin for begin, end in spans)
    returns: dict[int, Returns] = {}
    sweeps: dict[int, Sweep] = {}
    unread: dict[int, str] = {}
    for begin, end in spans:
        before: Revolution | None = None
        for k, revolution in revolutions_or_errors(stream, begin, end):
            if isinstance(revolution, DataError):
                returns[k], unread[k], before = Returns.none(), str(revolution), None
            else:
                returns[k] = detect(revolution, stream.range_resolution, config.detector)
                sweeps[k] = _sweep(stream, k, revolution, before)
                before = revolution
            progress(len(returns), total)
    kept = dict(zip(returns, drop_fixed(list(returns.values())), strict=True))
    begins, ends = stream.start_times.tolist(), stream.end_times.tolist()
    return [
        Stretch(
            tuple(Window(begins[k], ends[k], kept[k]) for k in range(*span)),
            tuple(sweeps[k] for k in range(*span) if k in sweeps),
            tuple(unread[k] for k in range(*span) if k in unread),
        )
        for span in spans
    ]


def _spans(stream: RadarStream, odometry: Trajectory | None) -> list[tuple[int, int]]:
    """Choose the stretches by their first revolutions and the ones after their last; they share none and hold no gap.

    Where gaps leave no stretch of the usual size, they are as long as the longest that there is.
    """
    gap_after = np.zeros(len(stream), dtype=np.int64)
    gap_after[[k for k, _ in stream.gaps()]] = 1
    gaps = np.cumsum(gap_after) - gap_after  # before each revolution
    size = min(REVOLUTIONS, int(np.bincount(gaps).max()))
    begins = np.arange(len(stream) - size + 1)
    begins = begins[gaps[begins] == gaps[begins + size - 1]]
    if odometry is None or size == 1:
        even = np.linspace(0, len(begins) - 1, 2 * STRETCHES + 1)[1::2]
        order = begins[np.round(even).astype(np.int64)]
    else:
        yaw_rates = odometry.mean_twists(stream.stamps_us[:-1], stream.stamps_us[1:])[:, 2]
        order = begins[np.argsort([-np.std(yaw_rates[b : b + size - 1]) for b in begins], kind="stable")]
    chosen: list[int] = []
    for begin in order.tolist():
        if len(chosen) < STRETCHES and all(abs(begin - other) >= size for other in chosen):
            chosen.append(begin)
    return [(begin, begin + size) for begin in sorted(chosen)]


def _sweep(stream: RadarStream, k: int, revolution: Revolution, before: Revolution | None) -> Sweep:
    steps = np.abs(np.diff(revolution.azimuths))
    usual = float(np.median(steps)) if len(steps) else 0.0
    after = float(stream.start_times[k + 1]) if k + 1 < len(stream) else np.inf
    return Sweep(
        azimuths=len(revolution.times),
        unmeasured=int(np.count_nonzero(~revolution.valid)),
        turned=float(steps.sum()) + usual,
        step=usual,
        widest=float(steps.max(initial=0.0)),
        turn_s=float(stream.turns_us[k]) * 1e-6,
        span_s=float(revolution.times[-1] - revolution.times[0]),
        late_s=max(0.0, float(revolution.times[-1]) - after),
        repeated=before is not None and np.array_equal(before.power, revolution.power),
    )
