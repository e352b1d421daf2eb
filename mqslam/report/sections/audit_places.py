"""What an audit's page shows of single places: those that are torn first, and those that could not be judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.core import se2
from mqslam.core.wording import count_of
from mqslam.report.content import Fold, Gallery, Section, Table, TableRow, Thumbnail, ThumbnailCard
from mqslam.report.figures.crops import draw_crop, make_crop
from mqslam.report.formatting import describe_motion, format_length
from mqslam.report.inputs.audit_report import AuditReport
from mqslam.report.places.bad_places import NAMES
from mqslam.report.places.spots import Spot, find_worst_spots

_MOST: Final = 8  # stretches of one kind that a page names; the files hold all
_UNKNOWN: Final = "rows whose torn is unknown"

Judged = TypeVar("Judged")


@dataclass(frozen=True, slots=True)
class Unmatched:
    """A stretch of the path of which nothing could be decided.

    Args:
        what: what could not be judged, with how many of them.
        time: when it was, in words.
        where: where it is, in words.
        why: why not.
        look: where to look for it.
    """

    what: str
    time: str
    where: str
    why: str
    look: str


def find_unmatched(sweeps: Sweeps, audit: Audit) -> tuple[Unmatched, ...]:
    """Returns the stretches of windows, steps and revisits of which nothing could be decided.

    Args:
        sweeps: what was judged.
        audit: its judgement.
    """
    windows = _name_stretches(
        _group(audit.windows, lambda window: window.undecided),
        lambda window: (window.t0, window.t1),
        lambda window: window.pose,
        ("window", f"audit.csv, {_UNKNOWN}"),
    )
    steps = _name_stretches(
        _group(audit.steps, lambda step: None if step.judged else "the scans before and after it fit no single place"),
        lambda step: (step.t, step.t),
        lambda step: sweeps.poses[step.laid.later],
        ("step", f"steps.csv, {_UNKNOWN}"),
    )
    why = "its two passes are not sure to fit at one place alone"
    revisits = _name_stretches(
        _group(audit.revisits, lambda judged: None if judged.revisit.sure else why),
        lambda judged: (float(sweeps.times[judged.revisit.earlier]), float(sweeps.times[judged.revisit.later])),
        lambda judged: sweeps.poses[judged.revisit.later],
        ("revisit", f"revisits.csv, {_UNKNOWN}"),
    )
    return (*windows, *steps, *revisits)


def _group(items: Sequence[Judged], reason: Callable[[Judged], str | None]) -> list[tuple[str, list[Judged]]]:
    """Returns stretches of successive items that share a reason for not being judged, with that reason."""
    stretches: list[tuple[str, list[Judged]]] = []
    last: str | None = None
    for item in items:
        why = reason(item)
        if why is not None and why == last:
            stretches[-1][1].append(item)
        elif why is not None:
            stretches.append((why, [item]))
        last = why
    return stretches


def _name_stretches(
    stretches: list[tuple[str, list[Judged]]],
    times: Callable[[Judged], tuple[float, float]],
    pose: Callable[[Judged], se2.Array],
    names: tuple[str, str],
) -> list[Unmatched]:
    """Returns the longest stretches in words, in the order of time, and a line for those that are left out."""
    noun, look = names
    longest = sorted(range(len(stretches)), key=lambda k: (-len(stretches[k][1]), k))[:_MOST]
    named = []
    for k in sorted(longest):
        why, items = stretches[k]
        begin, end = times(items[0])[0], times(items[-1])[1]
        time = f"at {begin:.1f} s" if begin == end else f"{begin:.1f} s to {end:.1f} s"
        x, y = pose(items[len(items) // 2])[:2]
        where = f"({round(x)}, {round(y)}) m".replace("-", "−")
        named.append(Unmatched(count_of(len(items), noun), time, where, why, look))
    left = sum(len(items) for k, (_, items) in enumerate(stretches) if k not in longest)
    if left:
        named.append(Unmatched(f"{count_of(left, noun)} more", "", "", "as above", look))
    return named


_HEAD: Final = ("", "what", "time", "place", "off by", "correction", "inflation", "verdict")
_FINE: Final = "The largest corrections of what is not torn"


def list_worst(report: AuditReport) -> Section | None:
    """Returns the worst places as a table: torn ones at once, the others unfold."""
    spots = find_worst_spots(report.sweeps, report.audit, report.config.audit)
    if not spots:
        return None
    torn, fine = ([(k, spot) for k, spot in enumerate(spots, 1) if spot.torn is wanted] for wanted in (True, False))
    notes = (
        "Torn places come first, by how far they are off." if torn else "No place is torn.",
        "After them come the windows of the largest inflation; all are well apart.",
        "A correction, as seen from the sensor, moves the end of a window or span against its begin, what follows a jump, "
        "or the later pass of a revisit.",
        f"{' and '.join(NAMES)} beside this page hold all places that are torn or of which nothing could be decided.",
    )
    folded = Fold(_FINE, _tabulate(fine)) if fine else None
    return Section("Worst places", notes, table=_tabulate(torn) if torn else None, folded=folded)


def list_unmatched(report: AuditReport) -> Section | None:
    """Returns what could not be judged, where it is, and where to look; None where all could be judged."""
    places = find_unmatched(report.sweeps, report.audit)
    blind = tuple(str(line) for line in report.summary.get("not_judged") or ())
    if not places and not blind:
        return None
    rows = tuple(TableRow(place.what, (place.time, place.where, place.why, place.look)) for place in places)
    table = Table(("what", "time", "place", "why", "where to look"), rows, holds_words=True) if rows else None
    notes = ("Nothing is said of these places: they are neither good nor bad.", *blind)
    return Section("What could not be matched", notes, table=table)


def show_crops(report: AuditReport) -> Gallery | None:
    """Returns pictures of the worst places before and after their corrections: torn ones at once, the others unfold."""
    spots = find_worst_spots(report.sweeps, report.audit, report.config.audit)
    torn: list[ThumbnailCard] = []
    fine: list[ThumbnailCard] = []
    for k, spot in enumerate(spots, 1):
        crop = make_crop(report.sweeps, spot)
        before, after = draw_crop(crop)
        title = f"{k}. {crop.title}"
        thumbnails = (
            Thumbnail(before, "as it is", f"{title}, before"),
            Thumbnail(after, "corrected", f"{title}, after"),
        )
        (torn if spot.torn else fine).append(ThumbnailCard(title, thumbnails, crop.text))
    note = (
        "The points where the correction shows the most, seen from the sensor, ahead to the right. Blue is what was "
        "seen first, orange what was seen last: a wall in two colours is doubled."
    )
    return Gallery("Before and after", note, tuple(torn), tuple(fine), _FINE) if spots else None


def _tabulate(spots: Sequence[tuple[int, Spot]]) -> Table:
    return Table(_HEAD, tuple(TableRow(f"{number}", _list_values(spot)) for number, spot in spots), holds_words=True)


def _list_values(spot: Spot) -> tuple[str, ...]:
    off, motion = format_length(spot.off_m), describe_motion(spot.correction)
    return (spot.kind, spot.time, spot.place, off, motion, spot.inflation_text, spot.verdict)
