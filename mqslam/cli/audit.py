"""`mqslam audit`: judges the map of any SLAM system without ground truth, and lists the places where the map is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from mqslam.cli.options import Options, argument, choose_exit_code, command, flag, option
from mqslam.cli.remedies import name_options
from mqslam.cli.terminal import Terminal, echo, format_rows, format_verdict

if TYPE_CHECKING:
    from mqslam.commands.result import AuditResult

_OWN: Options = {
    "data": argument(Path, ..., "DATA", "A radar or lidar recording, or a point cloud with times (PLY, PCD, LAS, NPZ)."),
    "trajectory": option(
        str | None,
        None,
        r"The trajectory to judge: a file (TUM, KITTI with --times, a bag, or a CSV with a header such as t\[us],x,y,yaw), "
        "the folder of a result of mqslam, KISS-SLAM, CFEAR or TBV, or the name of a trajectory that DATA holds: "
        "odometry, ground_truth, or recording (the poses in a lidar's log; the default).",
        "--trajectory",
        "-t",
    ),
    "times": option(Path | None, None, "File with the stamps of a KITTI trajectory, one per line."),
    "topic": option(str | None, None, "Topic of the trajectory, if it is in a bag."),
    "frame": option(str | None, None, "Frame whose poses in /tf of a bag are the trajectory."),
    "time_offset_s": option(
        float,
        0.0,
        "Time to add to the stamps of the trajectory, if its clock differs from the clock of DATA.",
        "--time-offset",
        metavar="SECONDS",
    ),
    "extrinsics": option(
        str | None,
        None,
        r"Pose of the sensor in the frame whose trajectory the file holds, such as base_link: \[m] forward, \[m] "
        r"to the left, \[degrees] to the left.",
        metavar="X,Y,YAW",
    ),
    "z_range": option(
        str | None, None, r"Heights between which points of a cloud are used \[m]; all by default.", metavar="LOW,HIGH"
    ),
    "covariances": option(
        Path | None,
        None,
        "Covariances of the trajectory's poses, which the audit compares with the errors at revisits: a run's "
        "covariances.csv, TUM with the covariance after each pose (36, 21 or 12 numbers), or a bag with "
        "PoseWithCovarianceStamped or Odometry. Covariances in the trajectory's own file need no option.",
        metavar="FILE",
    ),
    "false_alarms": option(
        float | None,
        None,
        "Probability, below 0.5, that those tests of the map that give p-values, taken together, call a good map bad by "
        "chance. 0.01 by default.",
        metavar="RATE",
    ),
    "test": option(Path | None, None, "Python file with a test of your own, which also judges the map.", metavar="FILE"),
    "baseline": option(
        Path | None,
        None,
        "Folder of an earlier audit. Exit with 1 if the verdict or a test is worse than in that audit; from the worst, the "
        "verdicts are fail, warn, not judged, pass.",
        "--baseline",
        metavar="OLD",
    ),
    "mend": flag(
        "Correct the errors of the trajectory that the audit has found, write the corrected trajectory as mended.tum, and "
        "judge it, too. --fail-on still looks at the verdict on the given trajectory.",
        "--mend",
    ),
}

_LISTED = 3  # at most this many torn windows and this many torn revisits are printed, the worst first


@command(
    "data out trajectory times topic frame time_offset_s extrinsics z_range covariances false_alarms tolerance test fail_on "
    "baseline mend config changes format range_resolution start_s end_s jobs cluster resume force as_json quiet verbose",
    _OWN,
)
def audit(
    terminal: Terminal,
    *,
    trajectory: str | None,
    z_range: str | None,
    fail_on: Literal["warn", "fail"] | None,
    **given: Any,
) -> None:
    """Judge the map that a recording makes under a trajectory, without ground truth.

    Each window (several consecutive scans) is compared with the best map of the same scans, which has the lowest score psi.
    The inflation of a window is the squared correction that leads to this best map, in units of its covariance; where the
    map is right, it follows a chi-square distribution with 3 degrees of freedom. Where the sensor passes a place twice, psi
    registers the two passes on each other, which shows how far the trajectory misplaces them.

    Example: mqslam audit drive --trajectory result/trajectory.tum --out audited --fail-on fail
    """
    from mqslam.commands.audit import audit as do

    heights = _parse_heights(z_range)
    with terminal.open_work() as work:
        result = do(trajectory=trajectory or "recording", heights=heights, work=work, **given)

    terminal.print_results(result.summary, lambda: print_audit(terminal, result))
    if result.worse:
        raise typer.Exit(1)
    if fail_on is not None:
        raise typer.Exit(choose_exit_code(result.verdict, fail_on))


def print_audit(_: Terminal, result: AuditResult) -> None:
    """Prints the results of an audit as text for people."""
    echo(name_options(_format_results(result.summary)))
    if (baseline := result.summary["baseline"]) is not None:
        worse = f"worse than {baseline['path']}: {'; '.join(result.worse)}"
        echo(worse if result.worse else f"nothing is worse than in {baseline['path']}")
    echo(f"results in {result.folder}; open {result.report} in a browser")


def _parse_heights(text: str | None) -> tuple[float, float] | None:
    """Returns the lowest and the highest height [m] from a text LOW,HIGH; None if there is no text.

    Raises:
        ConfigError: the text does not consist of two numbers.
    """
    from mqslam.errors import ConfigError

    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"--z-range {text}: give two heights in metres, such as 0.5,2.0") from None
    return low, high


def _describe_final_psi(final: dict[str, float | None]) -> str:
    """Describes by which factors psi of a map exceeds the best psi of its returns, given `final_psi` of audit.json."""
    windows, passes = final["over_best_of_windows"], final["over_best_of_passes"]
    parts = [] if windows is None else [f"{windows:.2f} times the best possible in windows"]
    parts += [] if passes is None else [f"{passes:.2f} times the best possible across passes"]
    return " and ".join(parts) or "unknown"


def _format_results(summary: dict[str, Any]) -> str:
    """Returns verdict, final psi, worst places, covariances and mending as text, given the content of audit.json."""
    from mqslam.auditing.table import TESTS
    from mqslam.core.wording import list_outcomes

    rows = [*format_verdict(summary), ("final psi", _describe_final_psi(summary["final_psi"]))]
    if summary["verdict"]["status"] != "pass":
        rows += _list_worst(summary)
    verdict, can_mend = summary["verdict"], summary["trajectory"] is not None and "mended" not in summary
    names_remedy = not {"give", "must"}.isdisjoint(verdict["diagnosis"].split())  # better advice than --mend
    found_bad = {name for name, test in summary["tests"].items() if test["status"] in ("warn", "fail")}
    is_mendable = not found_bad.isdisjoint(test.name for test in TESTS if test.is_mendable)
    if can_mend and is_mendable and not names_remedy:
        rows.append(("to mend it", "audit again with --mend, which writes a corrected trajectory"))
    rows += list_outcomes(summary)
    if "mended" in summary:
        verdict = summary["mended"]["verdict"]
        rows.append(("verdict then", f"{verdict['status']}: {verdict['diagnosis']}"))
    return format_rows(rows, 14)


def _list_worst(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Returns the torn windows and torn revisits with the largest errors as rows (name, text), given audit.json."""
    windows = sorted((w for w in summary["per_window"] if w["torn"]), key=lambda w: -w["size_m"])[:_LISTED]
    rows = []
    for w in windows:
        why = f"bent by {w['size_m']:.2f} m"
        if w.get("by_speed"):  # audits of earlier versions lack it
            why = f"not bent, but the scans contradict its speed by {w['speed_error']:.2g} m/s"
        rows.append(("torn window", f"{_place(w, w['t0'], w['t1'])}: {why}"))
    revisits = [r for r in summary["per_revisit"] if r["torn"]]
    for r in sorted(revisits, key=lambda r: -(r["dx"] ** 2 + r["dy"] ** 2))[:_LISTED]:
        off = f"off by {r['dx']:z.2f} m, {r['dy']:z.2f} m, {57.29578 * r['dyaw']:z.2f} deg"
        rows.append(("torn revisit", f"{_place(r, r['t_earlier'], r['t_later'])}: {off}"))
    return rows


def _place(row: dict[str, Any], begin: float, end: float) -> str:
    return f"{begin:.1f} to {end:.1f} s at ({row['x']:z.1f}, {row['y']:z.1f}) m"
