"""`mqslam score`: computes psi of a window of a recording under a given motion, and the parts of psi."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mqslam.cli.options import OF_RADAR, Options, command, flag, option
from mqslam.cli.terminal import Terminal, echo, format_rows

if TYPE_CHECKING:
    from mqslam.config import ConfigSource
    from mqslam.core import se2

_AT_REST = "this is the minimum nearest to the given motion"
_MOVING = "the search was still moving after its last step; give the motion below as --motion to continue"
_UNITS = {"v": "m/s", "vx": "m/s", "vy": "m/s", "omega": "rad/s"}
_VARIANT: Options = {
    "temporal": option(
        str | None,
        None,
        "Temporal kernel: plateau, or gaussian (the paper's equation 8). Default: the setting psi.temporal.",
    ),
    "numerator": option(
        str | None,
        None,
        "Numerator of the Lorentzian L: tau/2 (the paper's equation 9) or tau (Algorithm 1). Default: the "
        "setting psi.numerator.",
    ),
    "factor": option(
        str | None,
        None,
        "Factor on the Lorentzian L: distance (the paper's equation 10) or kappa (Algorithm 1). Default: the "
        "setting psi.factor.",
    ),
    "unmatched": option(
        float | None,
        None,
        "Cost of a point without a neighbour, in units of the largest cost of a pair; the paper has 0. "
        "Default: the setting psi.unmatched.",
    ),
}
_OWN: Options = {
    "data": OF_RADAR,
    "start": option(float, ..., r"The window begins with the first scan at or after this time \[s since DATA begins]."),
    "motion": option(
        str,
        ...,
        r"The sensor's motion: v,omega or vx,vy,omega \[m/s, rad/s]; v and vx are forward, vy and omega to the left.",
    ),
    "revolutions": option(int, 3, "Length of the window, in scans.", min=2),
    "minimise": flag(
        "Also search for the minimum nearest to the given motion, which must be within some 0.5 m/s of the true one.",
        "--minimise",
    ),
    **_VARIANT,
}


@command(
    "data start motion revolutions config changes format range_resolution temporal numerator factor unmatched minimise "
    "as_json quiet verbose",
    _OWN,
)
def score(terminal: Terminal, *, motion: str, revolutions: int, config: ConfigSource, **given: Any) -> None:
    """Compute psi, the score of a map, for a window (several consecutive scans) under a motion.

    The lower psi, the crisper the map; only values of the same window can be compared. The result holds the published psi
    with its parts, and the psi that the estimator minimises. Ranges are corrected for the Doppler shift only if the settings
    state it, as --config oxford does; this command does not measure it.

    Example: mqslam score drive --start 2.0 --motion 9.1,0.05
    """
    from mqslam.commands.score import score_window
    from mqslam.config import PsiConfig, load_config, set_values
    from mqslam.config.yaml_file import check_tree

    settings = load_config(config)
    for name, value in [(name, given.pop(name)) for name in _VARIANT]:
        if value is not None:
            check_tree(PsiConfig, f"--{name} {value}", {name: value})  # raises an error that names the option
            settings = set_values(settings, "psi", **{name: value})
    scores = score_window(motion=parse_motion(motion), scans=revolutions, config=settings, **given)
    if not terminal.quiet:
        terminal.print_notes(scores["notes"])
    terminal.print_results(scores, lambda: echo(_format_results(scores)))


def parse_motion(text: str) -> se2.Array:
    """Returns the motion (2,) or (3,) from a text `v,omega` or `vx,vy,omega` [m/s, rad/s].

    Raises:
        ConfigError: the text has another form.
    """
    import numpy as np

    from mqslam.errors import ConfigError

    try:
        theta = np.array([float(part) for part in text.split(",")])
    except ValueError:
        theta = np.empty(0)
    if len(theta) not in (2, 3) or not np.isfinite(theta).all():
        raise ConfigError(
            f"--motion {text}: is not a motion; give v,omega or vx,vy,omega in m/s and rad/s, such as 9.1,0.05"
        )
    return theta


def _format_results(scores: dict[str, Any]) -> str:
    """Returns the scores of a window as text, given the dict that `score_window` returned."""
    window, variant, published, estimator = (scores[key] for key in ("window", "variant", "published", "estimator"))
    beta = scores["doppler_beta"]
    rows = [
        (
            "window",
            f"{window['revolutions']} scans of {window['revolution_s']:.3f} s from {window['t0']:.3f} s: "
            f"{window['points']} points",
        ),
        ("motion", _format_motion(scores["motion"])),
        ("doppler", f"{beta:g} s" if beta else "0 s: ranges are not corrected, because the settings state no shift"),
        ("", ""),
        ("published psi", f"{published['psi']:.6g}, {published['psi_per_point']:.6g} per point"),
        ("  pair sum (4)", f"{published['pair_sum']:.6g} over {published['pairs']} pairs"),
        ("  charge", f"{published['charge']:.6g} for points without a neighbour"),
        ("  matched", _format_matched(published)),
        ("  gradient", _format_gradient(published["gradient"])),
        (
            "  variant",
            f"temporal {variant['temporal']}, numerator {variant['numerator']}, factor {variant['factor']}, "
            f"unmatched {variant['unmatched']:g}",
        ),
        ("estimator's psi", f"{estimator['psi']:.6g}, {estimator['psi_per_point']:.6g} per point"),
        ("  matched", _format_matched(estimator)),
        ("  gradient", _format_gradient(estimator["gradient"])),
    ]
    if "minimised" in scores:
        best = scores["minimised"]
        status = best["status"] if best["settled"] or best["status"] != "converged" else "not finished"
        rows += [
            ("", ""),
            ("minimised", f"{status}: {_AT_REST if best['settled'] else _MOVING}"),
            ("  motion", _format_motion(best["motion"], best["standard_deviation"])),
            ("  estimator's", f"psi {estimator['psi']:.6g} before, {best['estimator']['psi']:.6g} after"),
            ("  published", f"psi {published['psi']:.6g} before, {best['published']['psi']:.6g} after"),
        ]
    return format_rows(rows, 17)


def _format_matched(score: dict[str, Any]) -> str:
    """Returns the share of the points that have a neighbour, with the distance within which neighbours count."""
    return f"{score['matched']:.1%} of the points have a neighbour within {score['radius_m']:g} m"


def _format_motion(motion: dict[str, float], deviations: dict[str, float] | None = None) -> str:
    """Returns the components of a motion with their units as text, and with their standard deviations if these are given."""
    spread = {name: f" +- {value:.2g}" for name, value in (deviations or {}).items()}
    return ", ".join(f"{name} {value:.5g}{spread.get(name, '')} {_UNITS[name]}" for name, value in motion.items())


def _format_gradient(gradient: dict[str, float]) -> str:
    """Returns the components of a gradient of psi with their units as text."""
    return ", ".join(f"{value:.5g} per {_UNITS[name]} of {name}" for name, value in gradient.items())
