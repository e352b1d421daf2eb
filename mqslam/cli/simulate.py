"""`mqslam simulate`: simulates a drive with known truth, in the Oxford layout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mqslam.cli.terminal.options import CORES, Jobs, Quiet, Verbose

_MOVERS = {"street": 6, "yard": 6, "corridor": 0, "tunnel": 0}
"""Usual number of moving vehicles; the scenes that are not named here know their own."""


def simulate(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder for the recording; it must not exist yet.")],
    scene: Annotated[str, typer.Option(help="The scene: street, yard, corridor, tunnel or city.")] = "street",
    duration: Annotated[float, typer.Option(min=1.0, help=r"Length of the drive \[s].")] = 60.0,
    turn_rate: Annotated[float, typer.Option(min=0.1, help=r"Turns of the radar per second \[1/s].")] = 4.0,
    azimuths: Annotated[int, typer.Option(min=8, help="Number of azimuths per turn.")] = 400,
    range_resolution: Annotated[float, typer.Option(min=0.01, help=r"Length of a range bin \[m].")] = 0.175,
    max_range: Annotated[float, typer.Option(min=5.0, help=r"Range of the farthest bin \[m].")] = 120.0,
    movers: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Number of moving vehicles; 6 by default, none in the corridor and the tunnel, about 200 in the city.",
        ),
    ] = None,
    doppler: Annotated[
        float | None,
        typer.Option(help=r"Doppler shift: range error per closing speed \[s]; none by default, 0.0502 with --chirps."),
    ] = None,
    chirps: Annotated[
        bool, typer.Option("--chirps", help="Let chirps go up and down in turn, as those of Boreas-RT's radar.")
    ] = False,
    imu: Annotated[str, typer.Option(help="Grade of the gyroscope: mems, good or none.")] = "mems",
    imu_rate: Annotated[float, typer.Option(help=r"Readings of the gyroscope per second, 50 to 200 \[1/s].")] = 100.0,
    imu_late: Annotated[float, typer.Option(help=r"How late the gyroscope's clock is \[s].")] = 0.0,
    seed: Annotated[
        int,
        typer.Option(
            help="Seed of the scene and the noise; the same seed gives the same bytes, and with another --movers the same "
            "streets."
        ),
    ] = 1,
    jobs: Jobs = CORES,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Simulate a drive through a scene, azimuth by azimuth, with ground truth, wheels that slip, a gyroscope and GNSS.

    Example: mqslam simulate drive --scene city --duration 60 --seed 1
    """
    from rich.console import Console

    from mqslam.cli.terminal.console import show_progress
    from mqslam.simulator import CHIRP_BETA, SensorModel
    from mqslam.simulator import simulate as write

    beta = doppler if doppler is not None else CHIRP_BETA if chirps else 0.0
    console = Console(stderr=True, markup=False)
    with show_progress(console, quiet) as show:
        write(
            out,
            scene=scene,
            duration_s=duration,
            sensor=SensorModel(turn_rate, azimuths, range_resolution, max_range, doppler_beta=beta, chirps=chirps),
            seed=seed,
            movers=_MOVERS.get(scene) if movers is None else movers,
            imu=imu,
            imu_rate_hz=imu_rate,
            imu_late_s=imu_late,
            jobs=jobs,
            progress=lambda done, total: show("simulate", done, total),
        )
    if not quiet:
        console.print(f"wrote {out}", highlight=False, soft_wrap=True)
