"""A few short stretches of a recording, read and detected: all that the checks look at besides stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mqslam.config import DetectorConfig
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.scans import Returns, Scans
from mqslam.core.trajectory import Trajectory
from mqslam.detection.artefacts import drop_fixed
from mqslam.detection.detector import detect
from mqslam.detection.stage import make_scans, read_polar_scans
from mqslam.errors import DataError

# Stretches of a recording that a check reads, and polar scans in each: enough to follow the motion through a bend or two,
# and read in a few seconds.
STRETCHES = 3
STRETCH_SCANS = 12


@dataclass(frozen=True, slots=True)
class Turn:
    """How one turn of the radar was measured, azimuth by azimuth.

    Args:
        azimuths: how many there are.
        unmeasured: how many of them are marked as not measured.
        turned: angle from the first azimuth to one step after the last [rad].
        step: usual step between neighbouring azimuths [rad].
        widest: widest step [rad].
        turn_s: duration of its turn [s].
        span_s: from the first azimuth's time to the last one's [s].
        late_s: by how much its last azimuth comes after the next polar scan's start [s], 0 where it does not.
        repeated: whether its power is that of the polar scan before, byte by byte.
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
    """Successive polar scans without a gap.

    Args:
        scans: their returns.
        turns: how each was measured that could be read.
        unread: why the others could not be read; their scans hold no returns.
    """

    scans: Scans
    turns: tuple[Turn, ...]
    unread: tuple[str, ...]


def read_stretches(
    recording: Recording,
    odometry: Trajectory | None,
    detector: DetectorConfig,
    progress: Callable[[int, int], object],
) -> list[Stretch]:
    """Reads the stretches that tell most: where odometry's yaw rate changes most, or else spread over the recording.

    Args:
        recording: the recording.
        odometry: of the same clock, or None.
        detector: settings of the detector.
        progress: called with (polar scans read, polar scans in all).
    """
    spans = choose_spans(recording, odometry)
    total = sum(end - begin for begin, end in spans)
    returns: dict[int, Returns] = {}
    turns: dict[int, Turn] = {}
    unread: dict[int, str] = {}
    for begin, end in spans:
        before: PolarScan | None = None
        for k, polar_scan in read_polar_scans(recording, begin, end):
            if isinstance(polar_scan, DataError):
                returns[k], unread[k], before = Returns.none(), str(polar_scan), None
            else:
                returns[k] = detect(polar_scan, recording.range_resolution, detector)
                turns[k] = _describe_turn(recording, k, polar_scan, before)
                before = polar_scan
            progress(len(returns), total)
    kept = dict(zip(returns, drop_fixed(list(returns.values())), strict=True))
    return [
        Stretch(
            make_scans(recording, [kept[k] for k in range(*span)], span[0]),
            tuple(turns[k] for k in range(*span) if k in turns),
            tuple(unread[k] for k in range(*span) if k in unread),
        )
        for span in spans
    ]


def choose_spans(recording: Recording, odometry: Trajectory | None) -> list[tuple[int, int]]:
    """Chooses the stretches, each by its first polar scan and the one after its last; they share none and hold no gap.

    Where gaps leave no stretch of the usual size, all are as long as the longest that there is.
    """
    gap_after = np.zeros(len(recording), dtype=np.int64)
    gap_after[[k for k, _ in recording.gaps()]] = 1
    gaps = np.cumsum(gap_after) - gap_after  # number of gaps before each polar scan
    size = min(STRETCH_SCANS, int(np.bincount(gaps).max()))
    begins = np.arange(len(recording) - size + 1)
    begins = begins[gaps[begins] == gaps[begins + size - 1]]
    if odometry is None or size == 1:
        even = np.linspace(0, len(begins) - 1, 2 * STRETCHES + 1)[1::2]
        order = begins[np.round(even).astype(np.int64)]
    else:
        yaw_rates = odometry.mean_twists(recording.stamps_us[:-1], recording.stamps_us[1:])[:, 2]
        order = begins[np.argsort([-np.std(yaw_rates[b : b + size - 1]) for b in begins], kind="stable")]
    chosen: list[int] = []
    for begin in order.tolist():
        if len(chosen) < STRETCHES and all(abs(begin - other) >= size for other in chosen):
            chosen.append(begin)
    return [(begin, begin + size) for begin in sorted(chosen)]


def _describe_turn(recording: Recording, k: int, polar_scan: PolarScan, before: PolarScan | None) -> Turn:
    """Returns how polar scan k was measured; the one before is None where it could not be read."""
    steps = np.abs(np.diff(polar_scan.azimuths))
    usual = float(np.median(steps)) if len(steps) else 0.0
    after = float(recording.start_times[k + 1]) if k + 1 < len(recording) else np.inf
    return Turn(
        azimuths=len(polar_scan.times),
        unmeasured=int(np.count_nonzero(~polar_scan.valid)),
        turned=float(steps.sum()) + usual,
        step=usual,
        widest=float(steps.max(initial=0.0)),
        turn_s=float(recording.turns_us[k]) * 1e-6,
        span_s=float(polar_scan.times[-1] - polar_scan.times[0]),
        late_s=max(0.0, float(polar_scan.times[-1]) - after),
        repeated=before is not None and np.array_equal(before.power, polar_scan.power),
    )
