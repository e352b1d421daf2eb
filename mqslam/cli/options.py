"""Arguments and options that several commands share."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Annotated

import typer


def _configs(incomplete: str) -> list[str]:
    """Names of shipped settings, for the shell to complete."""
    from mqslam.config import shipped_names

    return [name for name in shipped_names() if name.startswith(incomplete)]


def _frontends(incomplete: str) -> list[str]:
    """Names of front ends, for the shell to complete."""
    from mqslam.core.frontend import list_front_ends

    return [name for name in list_front_ends() if name.startswith(incomplete)]


def _formats(incomplete: str) -> list[str]:
    """Names of layouts, for the shell to complete."""
    from mqslam.formats.recordings import FORMATS

    return [name for name in FORMATS if name.startswith(incomplete)]


def _speak(verbose: bool) -> bool:
    """Let the package's log lines through to stderr, or keep them back."""
    log = logging.getLogger("mqslam")
    for handler in [h for h in log.handlers if isinstance(h, logging.StreamHandler)]:
        log.removeHandler(handler)
    if verbose:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
        log.addHandler(handler)
    log.setLevel(logging.INFO if verbose else logging.WARNING)
    return verbose


Data = Annotated[Path, typer.Argument(help="A recording: an Oxford-style folder, a rosbag (.bag, folder, .mcap), a .npz.")]
Format = Annotated[
    str | None,
    typer.Option("--format", help="Layout of DATA; guessed from the path by default.", autocompletion=_formats),
]
RangeResolution = Annotated[
    float | None, typer.Option("--range-resolution", help=r"Length of a range bin \[m], where DATA does not say or errs.")
]
ConfigOption = Annotated[
    str | None,
    typer.Option("--config", "-c", help="Settings: a YAML file, or the name of one that ships.", autocompletion=_configs),
]
Odometry = Annotated[
    str, typer.Option(help=r"auto: the recording's own if it has one; none; or a file (TUM, or CSV t\[us],v,omega).")
]
ConfigName = Annotated[
    str | None, typer.Argument(help="A YAML file, or the name of one that ships.", autocompletion=_configs)
]
Frontend = Annotated[
    str, typer.Option(help="psi, kiss_icp, open3d_icp, odometry, or one of yours.", autocompletion=_frontends)
]
Json = Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", callback=_speak, help="Say on stderr what each stage found and took.")
]
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
