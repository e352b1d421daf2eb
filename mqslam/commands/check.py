"""Checks whether a recording contradicts the assumptions by which it is read."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from mqslam.check.checks import Check, check_recording
from mqslam.commands.inputs import choose_odometry, open_data
from mqslam.commands.work import QUIET, Work
from mqslam.config import ConfigSource, load_config
from mqslam.errors import OfLidarError
from mqslam.psi.place import beam_of


def check(
    data: Path | str,
    *,
    odometry: str = "auto",
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
    work: Work = QUIET,
) -> Check:
    """Checks whether the stamps, azimuths, rotation and range bins of a recording are as mqslam assumes when it reads them.

    Args:
        data: the recording, of which a few short stretches are read.
        odometry: `auto` (the recording's own, if it has one), `none`, or the path of a file.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one; None takes the setting's or
            the recording's own.
        work: the functions that get progress and notes. Its engine is not used, since this process does all the work.

    Returns:
        The finding of each check, the notes, and the numbers of scans that were read and that the recording holds.

    Raises:
        ConfigError: a setting is wrong, the format is unknown, or the range resolution cannot be the length of a range bin.
        OfLidarError: the recording is a lidar's.
        DataError: the recording or the odometry file cannot be used.
    """
    settings = load_config(config)
    try:
        recording = open_data(Path(data), format, range_resolution, settings)
    except OfLidarError as error:
        problem = "is a lidar's recording, which itself states the angles and ranges that a check judges in a radar's"
        remedy = "`mqslam info` shows its scans, rate, ranges and odometry, and what is left out"
        raise OfLidarError(data, problem, remedy) from error
    track, notes = choose_odometry(recording, odometry, recording.mount)
    notes = [*recording.notes, *notes]
    for note in notes:
        work.tell(note)
    beam = beam_of(settings.estimator, settings.sensor.doppler_beta or 0.0)
    return check_recording(recording, track, settings, beam, notes, partial(work.progress, "detect"))
