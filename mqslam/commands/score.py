"""Computes psi, the score of a map, for a window under a motion: as published, and as the estimator minimises it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.commands.detect import check_scans
from mqslam.commands.inputs import open_data
from mqslam.config import ConfigSource, DetectorConfig, PsiConfig, load_config
from mqslam.core import se2
from mqslam.core.measurement import Status
from mqslam.core.motion import CONSTANT_TWIST, CONSTANT_VELOCITY, MotionModel
from mqslam.core.recording import Recording
from mqslam.core.scans import Returns, Scans
from mqslam.core.units import fit_to_lidar
from mqslam.core.wording import count_of
from mqslam.detection.stage import detect_stretch
from mqslam.errors import ConfigError, EstimationError, require_type
from mqslam.psi.minimiser import final_scale, kernel_of
from mqslam.psi.place import beam_of
from mqslam.psi.published.equations import PsiScore
from mqslam.psi.published.equations import score as published
from mqslam.psi.window import Window, WindowMotion


def score(scans: Scans, motion: Sequence[float] | se2.Array, *, config: ConfigSource = None) -> PsiScore:
    """Computes the published psi of a window (several consecutive scans) under a motion; the lower, the crisper the map.

    Only values of the same window can be compared, since places differ in the number of objects that are seen twice.
    Ranges are corrected for the Doppler shift only if `sensor.doppler_beta` of the settings states it.

    Args:
        scans: the window: two or more consecutive scans, such as `mqslam.detect("drive")[8:11]`.
        motion: constant twist of the sensor from the start of the first scan on: (2,) v forward [m/s], omega [rad/s], or
            (3,) vx forward, vy to the left [m/s], omega [rad/s].
        config: a `Config`, a dict of the settings that differ, such as `{"psi": {"s": 1.0}}`, the path of a YAML file, or
            the name of a shipped configuration; None takes the defaults. Section `psi` holds the parameters of the score.
            For a lidar's scans, those lengths in it that have their default values are multiplied by `unit_m` of the scans.

    Returns:
        The score. Its parts per point are in the order of the returns of the window, scan by scan, and its gradient in the
        order of `motion`.

    Raises:
        ConfigError: the scans, the motion or a setting is wrong.
        EstimationError: the window holds no returns.

    Source: "Motion Estimation from Map Quality with Millimeter Wave Radar", equations (4) and (8) to (10).

    Example:
        >>> mqslam.score(scans[8:11], (9.1, 0.05)).psi  # doctest: +SKIP
    """
    require_type(scans, Scans, "scans", "mqslam.Scans, such as mqslam.detect(recording)[8:11]")
    try:
        theta = np.asarray(motion, dtype=np.float64)
    except (TypeError, ValueError):
        theta = np.empty(0)
    if theta.shape not in ((2,), (3,)) or not np.isfinite(theta).all():
        raise ConfigError("motion: is not a motion; give v, omega or vx, vy, omega in m/s and rad/s, such as (9.1, 0.05)")
    if len(scans) < 2:
        raise ConfigError(f"scans: {count_of(len(scans), 'scan')} cannot be compared; give a window of two or more scans")
    scans, settings = check_scans(scans), load_config(config)
    settings = settings if scans.unit_m is None else fit_to_lidar(settings, scans)
    returns, estimator = Returns.concatenate([scan.returns for scan in scans]), settings.estimator
    if not len(returns):
        raise EstimationError("the scans of the window hold no returns")
    beam = beam_of(estimator, settings.sensor.doppler_beta or 0.0)
    window = Window(returns, scans[0].t0, kernel_of(estimator, scans.revolution_s), estimator, beam)
    return _publish(window, theta, CONSTANT_VELOCITY if len(theta) == 2 else CONSTANT_TWIST, settings.psi)


def score_window(
    data: Path | str,
    start: float,
    motion: se2.Array,
    *,
    scans: int = 3,
    minimise: bool = False,
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
) -> dict[str, Any]:
    """Computes psi, the score of a map, for a window (several consecutive scans) of a recording under a motion.

    Unlike `score`, it reads the scans from a file, and also computes the psi that the estimator minimises.

    Args:
        data: path of the recording.
        start: the first scan of the window begins at or after this time [s since the recording's start].
        motion: constant twist of the sensor: (2,) v forward [m/s], omega [rad/s], or (3,) vx forward, vy to the left [m/s],
            omega [rad/s].
        scans: number of scans in the window.
        minimise: whether the motion is estimated as well. The search finds the minimum nearest to the given motion.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one.

    Returns:
        A dict with `notes` on how the recording was read, `window`, `doppler_beta` [s] (0 if the settings state none),
        `variant`, `motion`, `published` (psi with its parts) and `estimator` (the estimator's psi). Each score holds the
        radius [m] within which it looks for neighbours. With `minimise` the dict also holds `minimised`: the estimated
        motion, whether the search came to rest there (`settled`), its status, and both scores.

    Raises:
        ConfigError: a setting is wrong, or the recording does not hold the window.
        DataError: the recording cannot be used, or a polar scan cannot be read.
        EstimationError: the window holds no returns.
    """
    settings = load_config(config)
    model = CONSTANT_VELOCITY if len(motion) == 2 else CONSTANT_TWIST
    recording = open_data(Path(data), format, range_resolution, settings)
    returns, t0 = read_window(recording, settings.detector, start, scans)
    beta = settings.sensor.doppler_beta or 0.0
    revolution_s, estimator = recording.revolution_s, settings.estimator
    window = Window(returns, t0, kernel_of(estimator, revolution_s), estimator, beam_of(estimator, beta))
    tree: dict[str, Any] = {
        "notes": list(recording.notes),
        "window": {"t0": t0, "revolutions": scans, "revolution_s": revolution_s, "points": len(returns)},
        "doppler_beta": beta,
        "variant": settings.psi.model_dump(include={"temporal", "numerator", "factor", "unmatched"}),
        "motion": dict(zip(model.parameters, motion.tolist(), strict=True)),
        **_score_motion(window, motion, model, settings.psi),
    }
    if minimise:
        twist = motion if model.size == 3 else motion[[0, 0, 1]] * [1.0, 0.0, 1.0]
        best = window.estimate(twist, model)
        tree["minimised"] = _describe_estimate(window, best, model) | _score_motion(window, best.theta, model, settings.psi)
    return tree


def read_window(recording: Recording, detector: DetectorConfig, start: float, scans: int) -> tuple[Returns, float]:
    """Detects the returns of successive scans; also returns the start of the first scan [s since the recording's start].

    Args:
        recording: the recording, of which only these scans are read.
        detector: settings of the detector.
        start: the first of these scans begins at or after this time [s since the recording's start].
        scans: number of scans.

    Raises:
        ConfigError: the recording does not hold these scans.
        DataError: a polar scan cannot be read.
        EstimationError: the scans hold no returns.
    """
    times = recording.start_times
    if len(times) < scans:
        raise ConfigError(f"{recording.path}: holds only {len(times)} scans; give a window of at most as many")
    last = times[len(times) - scans]
    if not -1e-6 <= start <= last + 1e-6:
        raise ConfigError(
            f"{recording.path}: no {scans} scans begin at {start:g} s in a recording that is "
            f"{recording.duration_s:.2f} s long; give a start of 0 to {np.floor(1e3 * last) / 1e3:g}"
        )
    first = int(np.searchsorted(times, start - 1e-6))
    detected = detect_stretch(recording, detector, first, first + scans)
    returns = Returns.concatenate(detected.returns)
    if not len(returns):
        raise EstimationError(
            f"{recording.path}: the {scans} scans from {start:g} s on hold no returns; lower detector.threshold"
        )
    return returns, float(times[first])


def _publish(window: Window, theta: se2.Array, model: MotionModel, variant: PsiConfig) -> PsiScore:
    """Returns psi of a window by the published equations in the form `variant`, under parameters (P,) of a motion model."""
    points = window.render(theta, model)
    return published(points.points, points.times, window.kernel.revolution_s, variant, points.jacobians)


def _score_motion(window: Window, theta: se2.Array, model: MotionModel, variant: PsiConfig) -> dict[str, Any]:
    """Returns the published psi of a window with its parts, and the estimator's psi with the narrowest kernel, as a dict."""
    whole, count = _publish(window, theta, model, variant), len(window.returns)
    own = window.score(theta, model, final_scale(window.config))
    return {
        "published": {
            "psi": whole.psi,
            "pair_sum": whole.pairs_psi,
            "charge": whole.charge,
            "pairs": whole.pairs,
            "radius_m": variant.s,
            "matched": float(whole.matched.mean()),
            "psi_per_point": whole.psi / count,
            "gradient": dict(zip(model.parameters, whole.gradient.tolist(), strict=True)),
        },
        "estimator": {
            "psi": own.psi,
            "psi_per_point": own.psi / count,
            "radius_m": window.config.s,
            "matched": float(own.matched.mean()),
            "gradient": dict(zip(model.parameters, (2.0 * own.gradient).tolist(), strict=True)),
        },
    }


def _describe_estimate(window: Window, best: WindowMotion, model: MotionModel) -> dict[str, Any]:
    """Returns the estimated motion with its standard deviations and status as a dict.

    The status is also degenerate if the motion is so uncertain that one standard deviation of it moves the points (RMS) by
    more than the widest kernel of the score, since the minimum that the search has found then says nothing about the motion.
    """
    deviations = best.covariance.diagonal() ** 0.5
    jacobians = window.render(best.theta, model).jacobians
    move_m = np.einsum("nip,pq,niq->n", jacobians, best.covariance, jacobians).mean() ** 0.5
    unknown = best.status is Status.CONVERGED and move_m > window.config.s_start
    return {
        "motion": dict(zip(model.parameters, best.theta.tolist(), strict=True)),
        "standard_deviation": dict(zip(model.parameters, deviations.tolist(), strict=True)),
        "settled": best.minimum.converged,
        "status": (Status.DEGENERATE if unknown else best.status).value,
    }
