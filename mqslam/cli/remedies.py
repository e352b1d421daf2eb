"""Replaces the remedies in errors and notes, which are in plain words, by sentences that name the options to give."""

from __future__ import annotations

import re

from mqslam.errors import Remedy

_WORDS: dict[str, str] = {
    Remedy.CHOOSE_OUTPUT: "choose another --out",
    Remedy.CHOOSE_OR_REMOVE_OUTPUT: "choose another --out or remove it",
    Remedy.CHOOSE_OR_REPLACE_OUTPUT: "choose another --out or give --force to replace it",
    Remedy.REMOVE_ONE_OR_REPLACE_ALL: "delete this folder to make this run again, or give --force to make all runs again",
    Remedy.CHOOSE_OR_RESUME_OUTPUT: "choose another --out or give --resume to continue the unfinished run in it",
    Remedy.CHOOSE_OR_WRITE_OUTPUT: "choose another --out or give --force to write into it",
    Remedy.FREE_SPACE: "free space or choose another --out",
    Remedy.GIVE_EXTRINSICS: "give --extrinsics",
    Remedy.GIVE_EXTRINSICS_OR_RADAR: (
        "give --extrinsics X,Y,YAW, or --frame radar: if there is odometry, a run then estimates the extrinsics"
    ),
    Remedy.NAME_GYROSCOPE: "give a file with the readings of a gyroscope by --imu",
    Remedy.SWITCH_GYROSCOPE_ON: "give --imu auto for the recording's own gyroscope, or --imu FILE for another",
    Remedy.GIVE_FITTING_TRAJECTORY: "give the --trajectory of the cloud, or --time-offset if their clocks differ",
    Remedy.GIVE_MORE_POSES: "give a --trajectory with a pose for every scan",
    Remedy.GIVE_ODOMETRY: "give --odometry FILE or another --frontend",
    Remedy.GIVE_OTHER_TRAJECTORY: "give a --trajectory with the stamps of DATA, or --time-offset if their clocks differ",
    Remedy.GIVE_RANGE_RESOLUTION: "give --range-resolution",
    Remedy.GIVE_TIMES: "give the file of its times, one per line, by --times of mqslam audit",
    Remedy.GIVE_TIME_OFFSET: "give --time-offset",
    Remedy.GIVE_TRAJECTORY: "give --trajectory FILE",
    Remedy.GIVE_TRAJECTORY_OR_NAME: "give --trajectory FILE, or --trajectory with the name of one that the recording has",
    Remedy.GIVE_VALUES: "give --values FILE",
    Remedy.LEAVE_STRICT_OUT: "mend the recording, or leave --strict out",
    Remedy.NAME_TOPIC: "name the radar's topic with --topic TOPIC",
    Remedy.NAME_LAYOUT: "name its layout by --format",
    Remedy.NAME_TARGET: "name the layout to write by --to",
    Remedy.MEND_FRONT_END: "mend it (-v shows its traceback), or choose another --frontend",
    Remedy.OVERRIDE_RANGE_OFFSET: "--set sensor.range_offset_m=METRES overrides it",
    Remedy.OVERRIDE_RANGE_RESOLUTION: "--range-resolution overrides it",
    Remedy.READ_WITH_RANGE_OFFSET: "read the result with --set sensor.range_offset_m=",
    Remedy.READ_WITH_RANGE_RESOLUTION: "read the result with --range-resolution",
    Remedy.OPEN_MAP_ELSEWHERE: "look at report.html, or give --rerun and open map.rrd elsewhere",
    Remedy.RECORD_LIVE_VIEW: "give --live FILE.rrd and open the file elsewhere",
    Remedy.REPLACE_UNFINISHED_OUTPUT: "choose another --out, or give --force instead of --resume",
    Remedy.RESUME: "continue with --resume",
    Remedy.WAIT_OR_CHOOSE_OUTPUT: "wait until that has ended, or choose another --out",
}
_OUT_IS_ARGUMENT = ("convert", "simulate")  # commands whose output is an argument, not an option
_ANY = re.compile("|".join(re.escape(remedy) for remedy in sorted(_WORDS, key=len, reverse=True)))


def name_options(text: str, command: str = "") -> str:
    """Returns a text in which each `Remedy` is replaced by words that name the option to give.

    Args:
        text: text of an error or a note.
        command: name of the command that the text comes from. For `convert` and `simulate` the output is named OUT.
    """
    output = "OUT" if command in _OUT_IS_ARGUMENT else "--out"
    return _ANY.sub(lambda remedy: _WORDS[remedy[0]].replace("--out", output), text)
