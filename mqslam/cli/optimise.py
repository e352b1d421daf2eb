"""`mqslam optimise`: optimises a pose graph in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import Force, Json, Quiet, Verbose


def optimise(
    graph: Annotated[
        Path,
        typer.Argument(
            metavar="GRAPH",
            help="A graph of poses in the plane or in space: a run's graph.g2o, any other .g2o, or what serialize() of "
            "gtsam.NonlinearFactorGraph returned.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The file to write the poses into: .g2o, or .tum for the graph of a run, beside which trajectory.tum lies. "
            "By default none is written."
        ),
    ] = None,
    values: Annotated[
        Path | None,
        typer.Option(help="What serialize() of gtsam.Values returned, for a graph that GTSAM has written."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Optimise a pose graph in a file, and print its error before and after.

    The edges of a .g2o have no losses: those with which a run keeps wrong loops and motions from bending its graph are not
    in its file. The poses that FIX names stay where they are; without any, the first one does.
    A run's graph.g2o holds the radar's poses and lacks gyroscope and GNSS, so that its optimum is the one without these.

    Example: mqslam optimise result/graph.g2o --out optimised.g2o
    """
    from mqslam.commands.graphs.optimise import optimise_file
    from mqslam.core.wording import count_of
    from mqslam.execution.files import to_json

    facts = optimise_file(graph, out, values=values, force=force)
    if as_json:
        typer.echo(to_json(facts))
    elif not quiet:
        where = {2: "in the plane", 3: "in space"}[facts["dimensions"]]
        rows = [
            ("graph", f"{count_of(facts['poses'], 'pose')} {where}, {count_of(facts['factors'], 'factor')}"),
            ("error", f"{facts['error_before']:.6g} before, {facts['error_after']:.6g} after"),
        ]
        if facts["out"] and out is not None:
            left_out = ""
            if facts["left_out"]:
                what = "is no edge" if facts["left_out"] == 1 else "are no edges"
                left_out = f", without {count_of(facts['left_out'], 'factor')} that {what} between poses"
            rows.append(("wrote", facts["out"] + (left_out if out.suffix == ".g2o" else "")))
        echo("\n".join(f"{name:<8}{value}" for name, value in rows))
