"""`mqslam simulate`: simulates a drive with known truth, in the Oxford layout."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mqslam.cli.options import Options, argument, command, flag, option
from mqslam.cli.terminal import Terminal

_OWN: Options = {
    "out": argument(Path, ..., "OUT", "Folder for the recording; it must not exist yet."),
    "scene": option(str, "street", "The scene: street, yard, corridor, tunnel or city."),
    "duration_s": option(float, 60.0, r"Length of the drive \[s].", "--duration", min=1.0),
    "turn_rate_hz": option(float, 4.0, r"Turns of the radar per second \[1/s].", "--turn-rate", min=0.1),
    "azimuths": option(int, 400, "Number of azimuths per turn.", min=8),
    "range_resolution": option(float, 0.175, r"Length of a range bin \[m].", min=0.01),
    "max_range": option(float, 120.0, r"Range of the farthest bin \[m].", min=5.0),
    "movers": option(
        int | None,
        None,
        "Number of moving vehicles; 6 by default, none in the corridor and the tunnel, about 200 in the city.",
        min=0,
    ),
    "doppler_beta": option(
        float | None,
        None,
        r"Doppler shift: range error per closing speed \[s]; 0 by default, 0.0502 with --chirps.",
        "--doppler",
    ),
    "range_offset": option(
        float,
        0.0,
        r"Range offset that the recording does not state: true range minus range of the bin's centre \[m].",
    ),
    "bin_error": option(
        float,
        0.0,
        "Share by which range bins are longer than the recording states, such as 0.01 for 1 %.",
    ),
    "azimuth_offset_deg": option(
        float,
        0.0,
        r"Direction of the beam when the encoder is at zero, counter-clockwise from straight ahead \[deg]; the recording "
        "does not state it.",
        "--azimuth-offset",
    ),
    "late_s": option(
        float, 0.0, r"How late every stamp of the radar is; all other sensors and the truth are on time \[s].", "--late"
    ),
    "chirps": flag("Let chirps go up and down in turn, as the chirps of Boreas-RT's radar do.", "--chirps"),
    "imu": option(str, "mems", "Grade of the gyroscope: mems, good or none."),
    "imu_rate_hz": option(float, 100.0, r"Readings of the gyroscope per second, 50 to 200 \[1/s].", "--imu-rate"),
    "imu_late_s": option(float, 0.0, r"How late the gyroscope's clock is \[s].", "--imu-late"),
    "seed": option(
        int,
        1,
        "Seed of the scene and the noise. The same options give the same files; --movers does not change the streets.",
    ),
}


@command(f"{' '.join(_OWN)} jobs quiet verbose", _OWN)
def simulate(terminal: Terminal, *, out: Path, **given: Any) -> None:
    """Simulate a drive of a spinning radar through a scene, and write it as a recording in the Oxford layout.

    The recording also holds ground truth, odometry of wheels that slip, a gyroscope and GNSS.

    Example: mqslam simulate drive --scene city --duration 60 --seed 1
    """
    from dataclasses import fields

    from mqslam.simulator import CHIRP_BETA, SensorModel
    from mqslam.simulator import simulate as write

    radar = {field.name: given.pop(field.name) for field in fields(SensorModel) if field.name in given}
    if radar["doppler_beta"] is None:
        radar["doppler_beta"] = CHIRP_BETA if radar["chirps"] else 0.0
    with terminal.show_progress() as show:
        write(
            out,
            sensor=SensorModel(**radar),
            jobs=terminal.jobs,
            progress=lambda done, total: show("simulate", done, total),
            **given,
        )
    if not terminal.quiet:
        terminal.print(f"wrote {out}")
