"""`mqslam score`: psi of a window of a recording under a motion, and its parts."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mqslam.cli.options import ConfigOption, Data, Format, Json, Quiet, RangeResolution, Verbose

if TYPE_CHECKING:
    from mqslam.config import DetectorConfig, EstimatorConfig, PsiConfig
    from mqslam.core import se2
    from mqslam.core.motion import MotionModel
    from mqslam.core.recording import Recording
    from mqslam.core.scans import Returns
    from mqslam.psi.place import Beam
    from mqslam.psi.window import WindowMotion

_UNITS = {"v": "m/s", "vx": "m/s", "vy": "m/s", "omega": "rad/s"}


def score(
    data: Data,
    start: Annotated[float, typer.Option(help=r"The first revolution from here on begins the window \[s since the start].")],
    motion: Annotated[str, typer.Option(help=r"v,omega or vx,vy,omega \[m/s, rad/s].")],
    revolutions: Annotated[int, typer.Option(min=2, help="Length of the window.")] = 3,
    config: ConfigOption = None,
    format: Format = None,
    range_resolution: RangeResolution = None,
    temporal: Annotated[
        str | None, typer.Option(help="Temporal kernel: plateau, or gaussian as printed in (8); else as the settings say.")
    ] = None,
    numerator: Annotated[
        str | None, typer.Option(help="Numerator of L: tau/2 as in (9), or tau as in Algorithm 1; else as the settings say.")
    ] = None,
    factor: Annotated[
        str | None,
        typer.Option(help="L is multiplied by: distance as in (10), or kappa as in Algorithm 1; else as the settings say."),
    ] = None,
    unmatched: Annotated[
        float | None,
        typer.Option(help="Charge of a point without a neighbour in dearest pairs, 0 as printed; else as the settings say."),
    ] = None,
    minimise: Annotated[bool, typer.Option("--minimise", help="Estimate the motion, beginning at the one given.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Score a window of a recording under a motion: the published psi and its parts, and the estimator's.

    Ranges are corrected for a Doppler shift where the settings name one (--config oxford).

    Example: mqslam score drive --start 2.0 --motion 9.1,0.05
    """
    from mqslam.commands.opening import opened
    from mqslam.config import load_config
    from mqslam.psi.place import beam_of
    from mqslam.psi.window import estimate_window

    settings = load_config(config)
    variant = psi_variant(settings.psi, temporal=temporal, numerator=numerator, factor=factor, unmatched=unmatched)
    theta, model = parse_motion(motion)
    recording = opened(data, format, range_resolution, settings.sensor)
    returns, t0 = read_window(recording, settings.detector, start, revolutions)
    beta = settings.sensor.doppler_beta or 0.0
    beam = beam_of(settings.estimator, beta)
    found: dict[str, Any] = {
        "window": {"t0": t0, "revolutions": revolutions, "revolution_s": recording.revolution_s, "points": len(returns)},
        "doppler_beta": beta,
        "variant": variant.model_dump(include={"temporal", "numerator", "factor", "unmatched"}),
        "motion": dict(zip(model.parameters, theta.tolist(), strict=True)),
        **scores(returns, t0, recording.revolution_s, theta, model, settings.estimator, beam, variant),
    }
    if minimise:
        twist = theta if model.size == 3 else theta[[0, 0, 1]] * [1.0, 0.0, 1.0]
        best = estimate_window(returns, t0, recording.revolution_s, settings.estimator, beam, twist, model)
        found["minimised"] = _estimate(best, model) | scores(
            returns, t0, recording.revolution_s, best.theta, model, settings.estimator, beam, variant
        )
    if as_json:
        typer.echo(json.dumps(found, indent=1))
    elif not quiet:
        typer.echo("\n".join(_lines(found)))


def parse_motion(text: str) -> tuple[se2.Array, MotionModel]:
    """Parameters and model of a motion written `v,omega` or `vx,vy,omega` [m/s, rad/s].

    Raises:
        ConfigError: anything else.
    """
    import numpy as np

    from mqslam.core.motion import CONSTANT_TWIST, CONSTANT_VELOCITY
    from mqslam.errors import ConfigError

    try:
        theta = np.array([float(part) for part in text.split(",")])
    except ValueError:
        theta = np.empty(0)
    if len(theta) not in (2, 3) or not np.isfinite(theta).all():
        raise ConfigError(f"motion '{text}': is no motion; give v,omega or vx,vy,omega in m/s and rad/s, such as 9.1,0.05")
    return theta, CONSTANT_VELOCITY if len(theta) == 2 else CONSTANT_TWIST


def psi_variant(settings: PsiConfig, **chosen: str | float | None) -> PsiConfig:
    """The settings of the published score with the given ones changed.

    Raises:
        ConfigError: a value that is not offered.
    """
    from pydantic import ValidationError

    from mqslam.config import PsiConfig
    from mqslam.errors import ConfigError

    try:
        return PsiConfig.model_validate(
            settings.model_dump() | {name: value for name, value in chosen.items() if value is not None}
        )
    except ValidationError as error:
        fault = error.errors()[0]
        raise ConfigError(f"--{fault['loc'][0]} {fault['input']}: {fault['msg']}") from error


def read_window(recording: Recording, detector: DetectorConfig, start: float, revolutions: int) -> tuple[Returns, float]:
    """The returns of the revolutions from the first that begins at `start` [s] or later, and when it begins [s].

    No other revolutions are read.

    Raises:
        ConfigError: the recording does not hold these revolutions.
        DataError: a revolution that cannot be read.
        EstimationError: they hold no returns.
    """
    import numpy as np

    from mqslam.core.scans import Returns
    from mqslam.detection.stage import detect_stretch
    from mqslam.errors import ConfigError, EstimationError

    times = recording.start_times
    if len(times) < revolutions:
        raise ConfigError(f"--revolutions {revolutions}: {recording.path} holds only {len(times)}; give fewer")
    last = times[len(times) - revolutions]
    if not -1e-6 <= start <= last + 1e-6:
        raise ConfigError(
            f"--start {start:g}: no {revolutions} revolutions begin there in {recording.path}, "
            f"{recording.duration_s:.2f} s long; give 0 to {np.floor(1e3 * last) / 1e3:g}"
        )
    first = int(np.searchsorted(times, start - 1e-6))
    found = detect_stretch(recording, detector, first, first + revolutions)
    returns = Returns.concatenate(found.returns)
    if not len(returns):
        raise EstimationError(f"--start {start:g}: no returns in these {revolutions} revolutions; lower detector.threshold")
    return returns, float(times[first])


def scores(
    returns: Returns,
    t0: float,
    revolution_s: float,
    theta: se2.Array,
    model: MotionModel,
    config: EstimatorConfig,
    beam: Beam,
    variant: PsiConfig,
) -> dict[str, Any]:
    """The published score of a window under a motion with its parts, and the estimator's at its final widths."""
    import numpy as np

    from mqslam.psi.minimiser import final_scale, score_itself
    from mqslam.psi.place import place
    from mqslam.psi.published.equations import score as published
    from mqslam.psi.window import drop_start

    points = drop_start(place(returns, t0, np.zeros(3), theta, model, beam))
    whole = published(points.points, points.times, revolution_s, variant, points.jacobians)
    own = score_itself(points, final_scale(config), revolution_s, config)
    return {
        "published": {
            "psi": whole.psi,
            "pair_sum": whole.pairs_psi,
            "charge": whole.charge,
            "pairs": whole.pairs,
            "matched": float(whole.matched.mean()),
            "psi_per_point": whole.psi / len(returns),
            "gradient": dict(zip(model.parameters, whole.gradient.tolist(), strict=True)),
        },
        "estimator": {
            "psi": own.psi,
            "psi_per_point": own.psi / len(returns),
            "matched": float(own.matched.mean()),
            "gradient": dict(zip(model.parameters, (2.0 * own.gradient).tolist(), strict=True)),
        },
    }


def _estimate(best: WindowMotion, model: MotionModel) -> dict[str, Any]:
    """The estimated motion as a tree."""
    deviations = best.covariance.diagonal() ** 0.5
    return {
        "motion": dict(zip(model.parameters, best.theta.tolist(), strict=True)),
        "standard_deviation": dict(zip(model.parameters, deviations.tolist(), strict=True)),
        "status": best.status.value,
    }


def _lines(found: dict[str, Any]) -> list[str]:
    """The tree as a person reads it."""
    window, variant, published, estimator = (found[key] for key in ("window", "variant", "published", "estimator"))
    rows = [
        (
            "window",
            f"{window['revolutions']} revolutions of {window['revolution_s']:.3f} s from {window['t0']:.3f} s: "
            f"{window['points']} points",
        ),
        ("motion", _motion(found["motion"])),
        ("doppler", f"{found['doppler_beta']:g} s"),
        ("", ""),
        ("published psi", f"{published['psi']:.6g}, {published['psi_per_point']:.6g} per point"),
        ("  pair sum (4)", f"{published['pair_sum']:.6g} over {published['pairs']} pairs"),
        ("  charge", f"{published['charge']:.6g} for points without a pair"),
        ("  matched", f"{published['matched']:.1%} of the points"),
        ("  gradient", _gradient(published["gradient"])),
        (
            "  variant",
            f"{variant['temporal']} in time, {variant['numerator']} above L, times {variant['factor']}, "
            f"unmatched {variant['unmatched']:g}",
        ),
        ("estimator's psi", f"{estimator['psi']:.6g}, {estimator['psi_per_point']:.6g} per point"),
        ("  matched", f"{estimator['matched']:.1%} of the points"),
        ("  gradient", _gradient(estimator["gradient"])),
    ]
    if "minimised" in found:
        best = found["minimised"]
        rows += [
            ("", ""),
            ("minimised", best["status"]),
            ("  motion", _motion(best["motion"], best["standard_deviation"])),
            ("  estimator's", f"psi {estimator['psi']:.6g} before, {best['estimator']['psi']:.6g} after"),
            ("  published", f"psi {published['psi']:.6g} before, {best['published']['psi']:.6g} after"),
        ]
    return [f"{name:<16} {value}".rstrip() for name, value in rows]


def _motion(motion: dict[str, float], deviations: dict[str, float] | None = None) -> str:
    """Its components with units, and standard deviations if given."""
    spread = {name: f" +- {value:.2g}" for name, value in (deviations or {}).items()}
    return ", ".join(f"{name} {value:.5g}{spread.get(name, '')} {_UNITS[name]}" for name, value in motion.items())


def _gradient(gradient: dict[str, float]) -> str:
    return ", ".join(f"{value:.5g} per {_UNITS[name]} of {name}" for name, value in gradient.items())
