"""Lists the places of an audited map that are torn or could not be judged, with their corrections, in words and in files.

`mqslam.results.audit_results` explains the words of an audit, such as sweep, jump, span and revisit. A sum adds up
successive spans. A stretch is a few successive sweeps. The correction of a place is the motion that makes its points fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from mqslam.auditing.judge import Audit
from mqslam.auditing.revisits import pick_passes
from mqslam.auditing.spans.measured import pick_ends
from mqslam.auditing.spans.sums import find_bends
from mqslam.auditing.steps import pick_sides
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.core.wording import count_of, describe_times
from mqslam.execution.files import write_json, write_text
from mqslam.report.words import ABSENT, describe_motion, describe_place, format_length, format_three_digits
from mqslam.results.files import format_csv, format_numbers

BAD_PLACES: Final = ("bad_places.csv", "bad_places.geojson")
_WORST: Final = 10  # most places that a page shows
_SPREAD_M: Final = 50.0  # least path length between two places of one kind, so that one bad stretch does not fill a page
_MOST: Final = 8  # most unjudged stretches of one kind that a page names; the files name all
_COLUMNS: Final = (
    *("kind", "torn", "t0", "t1", "x", "y", "yaw", "off_m", "dx", "dy", "dyaw"),
    *("inflation", "verdict", "description"),
)
_FRAME: Final = "x and y [m] in the frame of the trajectory that was audited, not degrees on the Earth"


@dataclass(frozen=True, slots=True)
class Spot:
    """A place of a map as a page shows it: a window, a jump, a torn span, a torn sum of spans or a torn revisit.

    Args:
        kind: `window`, `jump`, `span`, `sum` or `revisit`.
        time: time of the place, in words.
        t0, t1: begin and end of a window, or times of the earlier and the later stretch [s since the recording's start].
        pose: (3,) pose of the sensor at the window's middle, or at the later stretch, world frame.
        sweep: number of the sweep at that pose.
        stretches: numbers of the sweeps of a window, or of the earlier and of the later stretch.
        off_m: size of the correction [m]. For a window or a jump, root mean square of how far the correction moves the
            points; for a span, sum or revisit, length of the correction's x and y.
        correction: (3,) correction x, y [m], yaw [rad] of a window's end relative to its begin, or of the later stretch, in
            the frame of the pose.
        inflation: squared size of the correction in units of its covariance; None for a jump, which is judged by comparison
            with other steps.
        torn: whether the place counts as torn.
        text: size and direction of the correction, in words.
        undecided: why nothing could be decided about the place; None if it was decided.
    """

    kind: str
    time: str
    t0: float
    t1: float
    pose: se2.Array
    sweep: int
    stretches: tuple[Sequence[int], ...]
    off_m: float
    correction: se2.Array
    inflation: float | None
    torn: bool
    text: str
    undecided: str | None = None

    @property
    def title(self) -> str:
        """Kind, time and position of the place, in words."""
        return f"{self.kind} {self.time} at {describe_place(self.pose)}"

    @property
    def verdict(self) -> str:
        """Whether the place is torn, or why that is not known, in words."""
        if self.undecided is not None:
            return f"undecided: {self.undecided}"
        return "torn" if self.torn else "not torn"

    @property
    def cells(self) -> tuple[str, ...]:
        """The cells of the place in a table: kind, time, position, size and motion of correction, inflation, verdict."""
        inflation = ABSENT if self.inflation is None else format_three_digits(self.inflation)
        correction = format_length(self.off_m), describe_motion(self.correction)
        return (self.kind, self.time, describe_place(self.pose), *correction, inflation, self.verdict)


def find_worst_spots(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[Spot]:
    """Returns the worst places, at most `_WORST`: torn places by size of correction, then the other windows by inflation.

    Of two places of one kind that are not more than `_SPREAD_M` of path apart, only the worse one is returned.

    Args:
        sweeps: the points that were judged.
        audit: judgement of the map.
        settings: settings of the audit.
    """
    spots = [*spots_of_torn_pairs(sweeps, audit, settings), *map(spot_of_window, audit.windows)]
    chosen: list[Spot] = []
    for spot in sorted(spots, key=rank_spot, reverse=True):
        if len(chosen) < _WORST and all(_are_apart(sweeps, spot, other) for other in chosen):
            chosen.append(spot)
    return chosen


def rank_spot(spot: Spot) -> tuple[bool, float]:
    """Returns the rank of a place, larger for a worse place: torn places rank by size of correction, others by inflation.

    The correction of a place that is not torn may be large only because the place does not show some direction.
    """
    return spot.torn, spot.off_m if spot.torn or spot.inflation is None else spot.inflation


def spot_of_window(window: WindowAudit) -> Spot:
    """Returns the spot that describes a window, whether the window is torn or not."""
    bend = window.bend
    motion, size = describe_motion(bend.correction), format_length(bend.size_m)
    known = "; torn only because the scans contradict its speed" if window.by_speed else ""
    if not window.torn:
        known = ", not torn" if window.undecided is None else f", undecided: {window.undecided}"
    return Spot(
        kind="window",
        time=_describe_stretch(window.t0, window.t1),
        t0=window.t0,
        t1=window.t1,
        pose=window.pose,
        sweep=(window.begin + window.end) // 2,
        stretches=(range(window.begin, window.end),),
        off_m=bend.size_m,
        correction=bend.correction,
        inflation=bend.inflation,
        torn=window.torn,
        text=f"Its map is best with the window's end moved {motion} relative to its begin, which moves points by {size}; "
        f"{100.0 * bend.matched:.0f} % of them are seen twice. Inflation {format_three_digits(bend.inflation)}{known}.",
        undecided=window.undecided,
    )


def spots_of_torn_pairs(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[Spot]:
    """Returns the jumps, the torn spans, the torn sums of spans and the torn revisits as spots.

    Args:
        sweeps: the points that were judged.
        audit: judgement of the map.
        settings: settings of the audit.
    """
    spots: list[Spot] = []
    off: tuple[float, se2.Array, float | None]
    for registration in (jump.registration for jump in audit.jumps):
        fit = f"What was seen after the jump fits if it is moved {describe_motion(registration.offset)}"
        text = f"{fit}, which moves its points by {format_length(registration.size_m)}"
        pair, off = (registration.earlier, registration.later), (registration.size_m, registration.offset, None)
        spots.append(_spot_of_pair(sweeps, "jump", pair, pick_sides(registration.later), off, text, registration.matched))
    for span in (span for span in audit.spans if span.torn):
        pair = span.registration.earlier, span.registration.later
        inflation = float(se2.normalise(span.offset[None], span.covariance[None])[0])
        off = span.distance_m, span.offset, inflation
        text = _describe_fit("The end of the span", span.distance_m, span.offset)
        spots.append(_spot_of_pair(sweeps, "span", pair, pick_ends(pair), off, text, span.registration.matched))
    for bend in find_bends(audit.sums):
        pair = bend.earlier, bend.later
        inflation = float(se2.normalise(bend.offset[None], bend.covariance[None])[0])
        off = bend.distance_m, bend.offset, inflation
        text = _describe_fit(f"The end of these {bend.path_m:.0f} m of path", bend.distance_m, bend.offset)
        spots.append(_spot_of_pair(sweeps, "sum", pair, pick_ends(pair), off, text))
    for revisit in (revisit for revisit in audit.revisits if revisit.torn):
        one, off = revisit.registration, (revisit.distance_m, revisit.offset, revisit.inflation)
        pair = one.earlier, one.later
        text = _describe_fit("The later pass", revisit.distance_m, revisit.offset)
        passes = pick_passes(sweeps, *pair, settings)
        spots.append(_spot_of_pair(sweeps, "revisit", pair, passes, off, text, one.matched))
    return spots


def _describe_stretch(t0: float, t1: float) -> str:
    """Returns begin `t0` and end `t1` [s] in words, such as `2.0 s to 3.5 s`, or `at 2.0 s` if both are written alike."""
    return describe_times(t0, t1).removeprefix("from ")


def _describe_fit(what: str, off_m: float, correction: se2.Array) -> str:
    """Returns in words how far and in which direction the later of two stretches must move to fit the earlier stretch.

    Args:
        what: name of the later stretch, as subject of the sentence.
        off_m: distance that the later stretch must move [m].
        correction: (3,) motion x, y [m], yaw [rad] that makes the later stretch fit.
    """
    return f"{what} fits {format_length(off_m)} from where the trajectory has it, moved {describe_motion(correction)}"


def _spot_of_pair(
    sweeps: Sweeps,
    kind: str,
    pair: tuple[int, int],
    stretches: tuple[Sequence[int], Sequence[int]],
    off: tuple[float, se2.Array, float | None],
    text: str,
    matched: float | None = None,
) -> Spot:
    """Returns a torn pair of stretches as a spot.

    Args:
        sweeps: the points that were judged.
        kind: `jump`, `span`, `sum` or `revisit`.
        pair: number of the sweep at the earlier stretch, and of the sweep at the later stretch, where the spot is.
        stretches: numbers of the sweeps of the earlier and of the later stretch.
        off: size of the later stretch's correction [m]; the correction (3,) x, y [m], yaw [rad] in the frame of the later
            sweep; and its inflation, which is None for a jump.
        text: where the later stretch fits, in words.
        matched: share of the later stretch's points that lie on the earlier stretch after the correction; None for a sum,
            whose two ends are not registered on each other.
    """
    t0, t1 = sweeps.times[list(pair)].tolist()
    time = {"jump": f"at {t1:.1f} s", "revisit": f"{t0:.1f} s and {t1:.1f} s"}.get(kind) or _describe_stretch(t0, t1)
    seen = "" if matched is None else f"; {100.0 * matched:.0f} % of its points then lie on what was seen before"
    fit = f"{text}{seen}."
    last = "" if off[2] is None else f" Inflation {format_three_digits(off[2])}."
    return Spot(kind, time, t0, t1, sweeps.poses[pair[1]], pair[1], stretches, *off, True, fit + last)


def _are_apart(sweeps: Sweeps, a: Spot, b: Spot) -> bool:
    """Returns whether a page may list both of two places: only if they differ in kind or are far apart along the path.

    Two windows must also have at least one sweep between them.
    """
    if a.kind != b.kind:
        return True
    if a.kind == "window" and a.stretches[0][0] <= b.stretches[0][-1] + 1 and b.stretches[0][0] <= a.stretches[0][-1] + 1:
        return False
    return bool(abs(sweeps.travelled[a.sweep] - sweeps.travelled[b.sweep]) > _SPREAD_M)


def list_unmatched(sweeps: Sweeps, audit: Audit) -> list[tuple[str, ...]]:
    """Lists undecided windows, steps and revisits, each kind apart; successive ones with the same reason share a row.

    Of more than `_MOST` rows of one kind, the rows that stand for the most windows, steps or revisits are listed, and a last
    row counts the windows, steps or revisits that are left.

    Args:
        sweeps: the points that were judged.
        audit: judgement of the map.

    Returns:
        The cells of each row: (1) count and kind, (2) time, (3) position, (4) reason, (5) where to look in which file.
    """
    unfit, unusual, unsure = (
        "the scans before and after it do not fit at one place only",
        "too few steps show how far off a step usually is",
        "its two passes may also fit at another place",
    )
    judged: dict[
        tuple[str, str], list[tuple[str | None, float, float, se2.Array]]
    ] = {  # of each item: why nothing was decided (None if decided), begin and end [s], pose
        ("window", "audit.csv"): [(w.undecided, w.t0, w.t1, w.pose) for w in audit.windows],
        ("step", "steps.csv"): [
            (
                None if step.judged else unusual if step.registration.unrivalled else unfit,
                step.t,
                step.t,
                sweeps.poses[step.registration.later],
            )
            for step in audit.steps
        ],
        ("revisit", "revisits.csv"): [
            (None if is_sure else unsure, *sweeps.times[[r.earlier, r.later]].tolist(), sweeps.poses[r.later])
            for r, is_sure in ((one.registration, one.sure) for one in audit.revisits)
        ],
    }
    rows: list[tuple[str, ...]] = []
    for (noun, name), items in judged.items():
        look = f"{name}, rows whose torn is unknown"
        groups = [list(group) for why, group in groupby(items, key=lambda item: item[0]) if why is not None]
        longest = sorted(range(len(groups)), key=lambda k: -len(groups[k]))[:_MOST]
        for k in sorted(longest):
            (why, begin, _, _), (_, _, end, _) = groups[k][0], groups[k][-1]
            time = _describe_stretch(begin, end)
            where = describe_place(groups[k][len(groups[k]) // 2][3])
            rows.append((count_of(len(groups[k]), noun), time, where, str(why), look))
        left = sum(len(group) for k, group in enumerate(groups) if k not in longest)
        if left:
            rows.append((f"{count_of(left, noun)} more", "", "", "as above", look))
    return rows


def list_bad_places(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[Spot]:
    """Returns all torn places and all undecided windows, in the order of their ends; a revisit ends with its later pass.

    Args:
        sweeps: the points that were judged.
        audit: judgement of the map.
        settings: settings of the audit.
    """
    windows = [spot_of_window(window) for window in audit.windows if window.torn or window.undecided is not None]
    return sorted([*windows, *spots_of_torn_pairs(sweeps, audit, settings)], key=lambda spot: (spot.t1, spot.kind))


def write_bad_places(folder: Path, spots: Sequence[Spot]) -> None:
    """Writes bad places as CSV and as GeoJSON into an existing folder; without places, both files are empty lists.

    In the files, lengths are in metres, angles in radians, and times in seconds since the recording began.

    Args:
        folder: the folder.
        spots: the places.

    Raises:
        OutputError: a file cannot be written.
    """
    rows = []
    for spot in spots:
        torn = str(spot.torn) if spot.undecided is None else "unknown"
        numbers = (spot.t0, spot.t1, *spot.pose.tolist(), spot.off_m, *spot.correction.tolist(), spot.inflation)
        rows.append(dict(zip(_COLUMNS, (spot.kind, torn, *numbers, spot.verdict, spot.text), strict=True)))
    write_text(folder / BAD_PLACES[0], format_csv(map(format_numbers, rows), _COLUMNS))
    features: list[dict[str, Any]] = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [row["x"], row["y"]]}, "properties": row}
        for row in rows
    ]
    content = {"type": "FeatureCollection", "name": "bad places", "frame": _FRAME, "features": features}
    write_json(folder / BAD_PLACES[1], content)
