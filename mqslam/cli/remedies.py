"""Remedies of errors in the words of the command line: which option to give."""

from __future__ import annotations

from mqslam.errors import Remedy

WORDS: dict[str, str] = {
    Remedy.CHOOSE_OUTPUT: "choose another --out",
    Remedy.CHOOSE_OR_REMOVE_OUTPUT: "choose another --out or remove it",
    Remedy.CHOOSE_OR_REPLACE_OUTPUT: "choose another --out or give --force to replace it",
    Remedy.CHOOSE_OR_RESUME_OUTPUT: "choose another --out or give --resume to continue the unfinished run in it",
    Remedy.CHOOSE_OR_WRITE_OUTPUT: "choose another --out or give --force to write into it",
    Remedy.FREE_SPACE: "free space or choose another --out",
    Remedy.GIVE_RANGE_RESOLUTION: "give --range-resolution",
    Remedy.LEAVE_STRICT_OUT: "mend it, or leave --strict out",
    Remedy.OPEN_MAP_ELSEWHERE: "look at report.html, or give --rerun and open map.rrd elsewhere",
    Remedy.RECORD_LIVE_VIEW: "give --live FILE.rrd and open the file elsewhere",
    Remedy.RESUME: "continue with --resume",
}
