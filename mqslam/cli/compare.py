"""`mqslam compare`: runs several front ends on one recording and judges the map of each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mqslam.cli.options import Options, command, flag, option
from mqslam.cli.remedies import name_options
from mqslam.cli.terminal import Terminal, echo
from mqslam.errors import show

if TYPE_CHECKING:
    from mqslam.commands.result import CompareResult

_ASCII_ARROWS = str.maketrans({"↓": "v", "↑": "^", "→": "->"})  # for terminals that show only ASCII
_OWN: Options = {
    "frontends": option(
        str,
        "psi,kiss_icp,open3d_icp,odometry",
        "Names or Python files of front ends, separated by commas; `+gyro` after a name adds the gyroscope to the graph.",
    ),
    "trajectory": option(
        list[str] | None,
        None,
        "A trajectory to compare with: TUM, CSV, a bag, or KITTI as POSES,TIMES. Repeat the option for several.",
        metavar="NAME=FILE",
    ),
    "odometry_only": flag("Only chain the front ends' motions, without pose graph and loops.", "--odometry-only"),
    "kiss_config": option(Path | None, None, "YAML file with KISS-ICP's own settings.", "--kiss-config"),
}


@command(
    "data out frontends trajectory odometry_only kiss_config tolerance config changes odometry imu format range_resolution "
    "topic start_s end_s jobs cluster resume force as_json quiet verbose",
    _OWN,
)
def compare(terminal: Terminal, *, trajectory: list[str] | None, **given: Any) -> None:
    """Run several front ends on the same returns with the same back end, and judge the maps that result.

    With a radar's recording, only the front end `odometry` uses odometry; with a lidar's recording, every front end does.
    The last line names the best row of the table: with ground truth, the row with the smallest drift or ATE; without, the
    row with the smallest share of torn windows and revisits. A window is torn if its inflation is larger than chance
    explains (the median is 2.37 for a right trajectory) and its error exceeds a tolerance.

    Example: mqslam compare drive --out compared --frontends psi,kiss_icp
    """
    from mqslam.commands.compare import compare as do

    trajectories = _parse_trajectories(trajectory or [])
    with terminal.open_work() as work:
        result = do(trajectories=trajectories, work=work, **given)

    terminal.print_results(result.summary, lambda: print_compared(terminal, result))


def print_compared(terminal: Terminal, result: CompareResult) -> None:
    """Prints the results of a comparison as text for people."""
    failures = sum(row["failure"] is not None for row in result.summary["rows"])
    terminal.print_warnings(result.warnings[failures:])  # the failures, which come first, stand below the table
    _print_table(result)
    for row in result.summary["rows"]:
        if row.get("verdict") in ("warn", "fail"):
            echo(f"{row['name']} is judged {row['verdict']}: {name_options(row['reasons'])}")
    echo(f"results in {result.folder}; open {result.report} in a browser")
    if result.conclusion:
        echo(result.conclusion)


def _parse_trajectories(texts: list[str]) -> dict[str, Path | tuple[Path, Path]]:
    """Returns the paths of trajectories by their NAMEs, from texts NAME=FILE or NAME=POSES,TIMES.

    Raises:
        ConfigError: a text has another form, or a name is given twice.
    """
    from mqslam.errors import ConfigError

    files: dict[str, Path | tuple[Path, Path]] = {}
    for text in texts:
        name, _, file = text.partition("=")
        if not name or not file:
            raise ConfigError(f"--trajectory {text}: give NAME=FILE, with a NAME of letters and digits")
        if name in files:
            raise ConfigError(f"--trajectory {text}: there is a row {name} already; choose another NAME")
        poses, _, times = file.partition(",")
        files[name] = (Path(poses), Path(times)) if times else Path(poses)
    return files


def _print_table(result: CompareResult) -> None:
    """Prints the table of a comparison transposed, so that it fits any terminal, and below it notes and failures of rows."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    cells, marked = result.table, result.marked
    console = Console(markup=False, highlight=False)
    failed = [line for line in cells[1:] if line[1].startswith("failed: ")]
    ran = {k: line for k, line in enumerate(cells[1:], 1) if line not in failed}
    shown = Table(show_edge=False, pad_edge=False)
    shown.add_column("")
    for line in ran.values():
        shown.add_column(show(line[0]), justify="right")
    arrows = _ASCII_ARROWS if console.options.ascii_only else {}
    for column, head in enumerate(cells[0][1:], 1):
        values = (
            Text(f"* {line[column]}", "bold") if (k, column) in marked else Text(line[column]) for k, line in ran.items()
        )
        shown.add_row(head.translate(arrows), *values)
    console.print(shown)
    for note in result.notes:
        echo(note.translate(arrows))
    for line in failed:
        echo(name_options(f"{line[0]} {line[1]}"))
