"""What a recording's power and returns are like, in figures that tell a kind simulated world from a real one.

The stretches are followed with fixed widths of the score and a fixed map, whatever the settings of a run are. They are
part of the figures' definition: a table stays comparable when the tracker's defaults change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import median_abs_deviation

from mqslam.check.stretches import choose_spans, track_scans
from mqslam.commands.inputs import open_data
from mqslam.config import Config, DetectorConfig, EstimatorConfig, TrackerConfig, load_config
from mqslam.core import se2
from mqslam.core.recording import PolarScan, Recording
from mqslam.core.scans import Returns, Scans
from mqslam.detection.artefacts import drop_fixed
from mqslam.detection.detector import detect
from mqslam.detection.stage import make_scans
from mqslam.errors import EstimationError
from mqslam.mapping.render import place_along
from mqslam.psi.place import Beam, beam_of
from mqslam.psi.tracking.cold_start import START_SCANS
from mqslam.psi.tracking.local_map import Tuning
from mqslam.psi.tracking.tracker import Tracked, Tracker

QUANTILES = (0.5, 0.9, 0.99, 0.999)
LEVELS = (40, 60, 80)  # readings of power, of 255, above which shares of bins are counted
AZIMUTHS_ON = (1, 2, 4)
METRES_ON = (0.2, 0.5, 1.0, 2.0)
SCANS_ON = (1, 4)
NEAR_M = 0.5  # a return that has another this near is seen again
FAR_M = 1.0  # a return that has none this near is not
_WIDTHS = {"s": 0.6, "beta_s": 0.25}
# Each match begins wide, none is left for a better one beside it, and all views count the same.
_TUNING = Tuning(
    keyframe_m=8.0,
    keyframes=40,
    final_width=1.0,
    first_step=0,
    prediction_margin=np.inf,
    doubtful_psi=np.inf,
    correlation=10.0,
    apart_share=1.0,
    apart_blur=1.0,
)
_TURNING = {"sigma_omega": 0.08, "sigma_alpha": 0.6}  # the same as in young tracks
_ASIDE_RAD = np.deg2rad(10.0)  # turned so far about the sensor, a scan meets another's returns by chance alone


@dataclass(frozen=True, slots=True)
class Statistics:
    """Figures of a recording, over a few short stretches of it."""

    scans: int  # number of polar scans they are from
    returns_per_azimuth: float  # mean number of returns
    power: tuple[float, ...]  # readings of power, of 255, at the quantiles `QUANTILES`
    loud: tuple[float, ...]  # share of bins with more power than each of `LEVELS`
    row_median: float  # mean over azimuths of the median reading of an azimuth
    row_median_spread: float  # its standard deviation
    azimuth_correlation: tuple[float, ...]  # correlation of power with that of so many azimuths on, `AZIMUTHS_ON`
    range_correlation: tuple[float, ...]  # correlation of power with that of so many metres on, `METRES_ON`
    ranges: tuple[float, ...]  # range of returns that half and nine tenths of them lie below [m]
    # share of returns with another within `NEAR_M` so many scans later, `SCANS_ON`; NaN where none follow
    repeats: tuple[float, ...]
    chance: float  # the same for the next scan turned by 10 degrees: what two scans of such a place share by chance
    unmatched: float  # share of returns with none within `FAR_M` in the next scan
    # spread in range of returns that are each other's nearest in successive scans: their median absolute deviation, as the
    # standard deviation of a normal one
    radial_spread_m: float
    matched: float  # share of a scan's returns that the tracker finds in the map of the scans before
    psi_per_point: float  # the estimator's psi of a scan in that map, per return


class _Power:
    """Counts of the readings of polar scans within the detector's range.

    Args:
        range_resolution: length of a range bin [m].
        detector: its settings say between which ranges power is looked at.
    """

    def __init__(self, range_resolution: float, detector: DetectorConfig) -> None:
        self._used = slice(int(detector.min_range_m / range_resolution), int(detector.max_range_m / range_resolution))
        self._bins_on = [max(1, round(metres / range_resolution)) for metres in METRES_ON]
        self._histogram = np.zeros(256, dtype=np.int64)
        self._medians: list[NDArray[np.float64]] = []
        self._correlations: list[list[float]] = []

    def add(self, polar_scan: PolarScan) -> None:
        """Counts a polar scan."""
        power = polar_scan.power[polar_scan.valid, self._used]
        self._histogram += np.bincount(power.ravel(), minlength=256)
        self._medians.append(np.median(power, axis=1))
        rows = power.astype(np.float32)
        across = [_correlate(rows, np.roll(rows, -step, axis=0)) for step in AZIMUTHS_ON]
        along = [_correlate(rows[:, :-step], rows[:, step:]) for step in self._bins_on]
        self._correlations.append(across + along)

    def describe(self) -> dict[str, Any]:
        """Returns the figures of power by their names in `Statistics`."""
        counts, medians = self._histogram, np.concatenate(self._medians)
        below = np.cumsum(counts) / counts.sum()
        means = np.mean(self._correlations, axis=0).tolist()
        return {
            "power": tuple(float(np.searchsorted(below, quantile)) for quantile in QUANTILES),
            "loud": tuple(float(counts[level + 1 :].sum() / counts.sum()) for level in LEVELS),
            "row_median": float(medians.mean()),
            "row_median_spread": float(medians.std()),
            "azimuth_correlation": tuple(means[: len(AZIMUTHS_ON)]),
            "range_correlation": tuple(means[len(AZIMUTHS_ON) :]),
        }


class _Pairs:
    """What successive scans of followed stretches see again of each other."""

    def __init__(self) -> None:
        self._repeats: dict[int, list[NDArray[np.bool_]]] = {on: [] for on in SCANS_ON}
        self._chance: list[NDArray[np.bool_]] = []
        self._unmatched: list[NDArray[np.bool_]] = []
        self._radial: list[NDArray[np.float64]] = []
        self._matched: list[NDArray[np.bool_]] = []
        self._psi: list[NDArray[np.float64]] = []

    def __bool__(self) -> bool:
        return bool(self._matched)

    def add(self, scans: Scans, tracked: Sequence[Tracked], beam: Beam) -> None:
        """Counts the returns of a stretch as psi tracks it; the scans that the track starts with have no map yet."""
        self._matched += [scan.evaluation.matched for scan in tracked[START_SCANS:]]
        self._psi += [scan.evaluation.shares for scan in tracked[START_SCANS:]]
        poses = np.array([scan.pose for scan in tracked])
        times = np.array([scan.t0 for scan in scans])
        placed = [place_along(scan.returns, times, poses, beam).points for scan in scans]
        trees = [cKDTree(points) for points in placed]
        later = {on: [tree.query(points) for points, tree in zip(placed, trees[on:], strict=False)] for on in SCANS_ON}
        for on, answers in later.items():
            self._repeats[on] += [away < NEAR_M for away, _ in answers]
        for k, (away, nearest) in enumerate(later[1]):
            self._unmatched.append(away > FAR_M)
            aside = np.array([*poses[k + 1, :2], _ASIDE_RAD])
            turned = se2.transform(aside, placed[k + 1] - poses[k + 1, :2])
            self._chance.append(cKDTree(turned).query(placed[k])[0] < NEAR_M)
            back = trees[k].query(placed[k + 1])[1]
            mutual = np.flatnonzero((back[nearest] == np.arange(len(nearest))) & (away < FAR_M))
            line = placed[k][mutual] - poses[k, :2]
            across = placed[k + 1][nearest[mutual]] - placed[k][mutual]
            self._radial.append(np.sum(across * line, axis=1) / np.maximum(np.hypot(*line.T), NEAR_M))

    def describe(self) -> dict[str, Any]:
        """Returns the figures of what is seen again by their names in `Statistics`."""
        return {
            "repeats": tuple(_mean(self._repeats[on]) for on in SCANS_ON),
            "chance": _mean(self._chance),
            "unmatched": _mean(self._unmatched),
            "radial_spread_m": float(median_abs_deviation(np.concatenate(self._radial), scale="normal")),
            "matched": _mean(self._matched),
            "psi_per_point": float(np.concatenate(self._psi).mean()),
        }


def describe_statistics(data: Path, config: Path | None = None) -> Statistics:
    """Measures the figures of a recording on disk, with the settings of a file or the usual ones.

    Raises:
        DataError: the recording cannot be used.
        EstimationError: no stretch of it can be followed.
    """
    settings = load_config(config)
    return measure_statistics(open_data(data, None, None, settings), settings)


def measure_statistics(recording: Recording, config: Config) -> Statistics:
    """Measures the figures of a recording over a few short stretches, which psi follows.

    Args:
        recording: the recording.
        config: settings, of which those of the tracker's yaw rate and of the score's widths do not count.

    Raises:
        DataError: a polar scan cannot be read.
        EstimationError: no stretch can be followed.
    """
    beam = beam_of(config.estimator, config.sensor.doppler_beta or 0.0)
    power, pairs = _Power(recording.range_resolution, config.detector), _Pairs()
    azimuths = 0
    stretches: list[Scans] = []
    for begin, end in choose_spans(recording, None):
        returns: list[Returns] = []
        for polar_scan in recording.polar_scans(begin, end):
            power.add(polar_scan)
            azimuths += int(polar_scan.valid.sum())
            returns.append(detect(polar_scan, recording.range_resolution, config.detector))
        scans = make_scans(recording, drop_fixed(returns), begin)
        stretches.append(scans)
        tracked = _follow(scans, config.tracker, config.estimator, beam)
        if tracked:
            pairs.add(scans, tracked, beam)
    if not pairs:
        raise EstimationError(
            f"{recording.path}: no stretch of it can be followed, for want of returns or of scans without a gap"
        )
    ranges = np.concatenate([scan.returns.ranges for scans in stretches for scan in scans])
    return Statistics(
        scans=sum(map(len, stretches)),
        returns_per_azimuth=len(ranges) / azimuths,
        ranges=tuple(np.quantile(ranges, [0.5, 0.9]).tolist()),
        **power.describe(),
        **pairs.describe(),
    )


def _follow(scans: Scans, tracker: TrackerConfig, estimator: EstimatorConfig, beam: Beam) -> list[Tracked]:
    """Returns the scans of a stretch as psi tracks them; none where it cannot be followed."""
    if len(scans) <= START_SCANS or not all(len(scan.returns) for scan in scans):
        return []
    try:
        settings = tracker.model_copy(update=_TURNING), estimator.model_copy(update=_WIDTHS)
        return track_scans(scans, Tracker(*settings, beam, scans.revolution_s, tuning=_TUNING))
    except EstimationError:
        return []


def _correlate(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """Returns the correlation of two arrays of readings; NaN where one does not vary."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def _mean(parts: Sequence[NDArray[np.bool_]]) -> float:
    """Returns the share of what is true in all parts; NaN without any."""
    return float(np.concatenate(parts).mean()) if parts else float("nan")
