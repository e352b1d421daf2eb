"""Arguments and options that several commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

Data = Annotated[Path, typer.Argument(help="A recording: an Oxford-style folder, a rosbag (.bag, folder, .mcap), a .npz.")]
Format = Annotated[str | None, typer.Option("--format", help="Layout of DATA; guessed from the path by default.")]
RangeResolution = Annotated[
    float | None, typer.Option("--range-resolution", help=r"Length of a range bin \[m], where DATA does not say or errs.")
]
ConfigOption = Annotated[
    str | None, typer.Option("--config", "-c", help="Settings: a YAML file, or the name of one that ships.")
]
Odometry = Annotated[
    str, typer.Option(help=r"auto: the recording's own if it has one; none; or a file (TUM, or CSV t\[us],v,omega).")
]
Json = Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", min=1, help="Processes to use; the result does not depend on it.")]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Work on a Dask cluster instead: tcp://host:port, or local:N for N workers on this machine.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace what is at --out.")]

CORES = os.cpu_count() or 1
