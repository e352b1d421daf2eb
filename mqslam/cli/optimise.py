"""`mqslam optimise`: optimises a pose graph in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mqslam.cli.options import Options, argument, command, option
from mqslam.cli.terminal import Terminal, echo, format_rows

_OWN: Options = {
    "graph": argument(
        Path,
        ...,
        "GRAPH",
        "A graph of poses in the plane or in space: a run's graph.g2o, any other .g2o, or a file with the text that "
        "serialize() of gtsam.NonlinearFactorGraph returned.",
    ),
    "out": option(
        Path | None,
        None,
        "The file to write the poses into: .g2o, or .tum if GRAPH lies beside the trajectory.tum of its run. By default no "
        "file is written.",
    ),
    "values": option(
        Path | None, None, "A file with the text of serialize() of gtsam.Values, for a graph that GTSAM has written."
    ),
}


@command("graph out values force as_json quiet verbose", _OWN)
def optimise(terminal: Terminal, *, out: Path | None, **given: Any) -> None:
    """Optimise a pose graph in a file, and print its error before and after.

    The edges of a .g2o have no robust losses; a run uses such losses so that wrong loops and motions do not bend its graph.
    The poses that the file's lines FIX name stay where they are; without FIX, the first pose stays. A run's graph.g2o leaves
    gyroscope and GNSS out, so that the optimum of this file may differ from the trajectory of the run.

    Example: mqslam optimise result/graph.g2o --out optimised.g2o
    """
    from mqslam.commands.optimise import optimise_file

    facts = optimise_file(out=out, **given)
    terminal.print_results(facts, lambda: echo(_format_results(facts, out)))


def _format_results(facts: dict[str, Any], out: Path | None) -> str:
    """Converts the dict that `optimise_file` returned to text: the graph's size, its error and the written file."""
    from mqslam.core.wording import count_of

    where = {2: "in the plane", 3: "in space"}[facts["dimensions"]]
    rows = [
        ("graph", f"{count_of(facts['poses'], 'pose')} {where}, {count_of(facts['factors'], 'factor')}"),
        ("error", f"{facts['error_before']:.6g} before, {facts['error_after']:.6g} after"),
    ]
    if facts["out"] and out is not None:
        left_out = ""
        if facts["left_out"] and out.suffix == ".g2o":
            what = "is no edge" if facts["left_out"] == 1 else "are no edges"
            left_out = f", without {count_of(facts['left_out'], 'factor')} that {what} between poses"
        rows.append(("wrote", facts["out"] + left_out))
    return format_rows(rows, 8)
