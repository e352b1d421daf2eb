"""`mqslam check`: shows whether a recording contradicts what was assumed to read it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import ConfigOption, Data, Format, Json, Odometry, Quiet, RangeResolution, Verbose
from mqslam.errors.shown import show

if TYPE_CHECKING:
    from mqslam.check.statistics import Statistics


def check(
    data: Data,
    config: ConfigOption = None,
    odometry: Odometry = "auto",
    statistics: Annotated[
        bool, typer.Option("--statistics", help="Show what power and returns are like, instead of checking.")
    ] = False,
    format: Format = None,
    range_resolution: RangeResolution = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Check a recording against what was assumed to read it: stamps, azimuths, rotation, length of a range bin.

    The check reads three short stretches. With odometry it can also tell a mirrored recording, stamps that mean the other
    end of the turn, and a wrong length of a range bin; the map alone shows none of them. Ground truth is not used.

    Exit code: 0 if nothing is suspicious, 1 if something is.

    With --statistics it shows figures of power and returns instead: how loud and how alike neighbours are, and what share of
    returns is seen again. They tell a simulated world that is too kind from a real one.

    Example: mqslam check drive

    Example: mqslam check drive --statistics
    """
    from dataclasses import asdict

    from rich.console import Console

    from mqslam.cli.terminal.console import set_up_work
    from mqslam.commands.check import check as do
    from mqslam.commands.check import describe_statistics
    from mqslam.execution.files import to_json

    silent = quiet or as_json
    with set_up_work(Console(stderr=True, markup=False), None, 1, quiet=silent, silent=silent) as work:
        if statistics:
            figures = describe_statistics(data, config=config, format=format, range_resolution=range_resolution, work=work)
            typer.echo(to_json(asdict(figures)) if as_json else "\n".join(_list_statistics(figures)))
            return
        outcome = do(data, odometry=odometry, config=config, format=format, range_resolution=range_resolution, work=work)
    if as_json:
        checks = [asdict(finding) for finding in outcome.findings]
        told = {"suspicious": outcome.suspicious, "notes": outcome.notes, "read": outcome.read, "scans": outcome.scans}
        typer.echo(json.dumps(told | {"checks": checks}, indent=1))
    else:
        for finding in outcome.findings:
            echo(f"{finding.name:<24}{finding.verdict:<18}{show(finding.text)}")
        if outcome.read < outcome.scans:
            rest = "a damaged one among the others shows in mqslam run, which reads all"
            echo(f"{outcome.read} of {outcome.scans} scans were read; {rest}")
        if outcome.warning is not None:
            echo(outcome.warning)
    if outcome.suspicious:
        raise typer.Exit(1)


def _list_statistics(figures: Statistics) -> list[str]:
    """Returns a line per figure, as a person reads them."""
    from mqslam.check.statistics import AZIMUTHS_ON, FAR_M, LEVELS, METRES_ON, NEAR_M, QUANTILES, SCANS_ON

    def join(values: tuple[float, ...], form: str) -> str:
        return " / ".join(format(value, form) for value in values)

    quantiles = join(tuple(100.0 * quantile for quantile in QUANTILES), "g")
    rows = [
        ("polar scans", f"{figures.scans}"),
        ("returns per azimuth", f"{figures.returns_per_azimuth:.2f}"),
        (f"power at {quantiles} %", join(figures.power, ".0f")),
        (f"share of bins over {join(LEVELS, 'd')}", join(figures.loud, ".3f")),
        ("median of an azimuth", f"{figures.row_median:.1f}, standard deviation {figures.row_median_spread:.1f}"),
        (f"correlation {join(AZIMUTHS_ON, 'd')} azimuths on", join(figures.azimuth_correlation, ".2f")),
        (f"correlation {join(METRES_ON, 'g')} m on", join(figures.range_correlation, ".2f")),
        ("range of 50 / 90 % of the returns", f"{join(figures.ranges, '.1f')} m"),
        (f"returns within {NEAR_M:g} m {join(SCANS_ON, 'd')} scans on", join(figures.repeats, ".2f")),
        ("the same by chance", f"{figures.chance:.2f}"),
        (f"no return within {FAR_M:g} m in the next scan", f"{figures.unmatched:.2f}"),
        ("spread in range of pairs", f"{figures.radial_spread_m:.2f} m"),
        ("matched share", f"{figures.matched:.2f}"),
        ("psi per point", f"{figures.psi_per_point:.2f}"),
    ]
    return [f"{name:<40}{value}" for name, value in rows]
