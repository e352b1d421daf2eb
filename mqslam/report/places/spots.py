"""The worst places of an audited map, and what would correct them, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from mqslam.auditing.judge import Audit
from mqslam.auditing.revisits import Revisit, pick_passes
from mqslam.auditing.spans.measured import pick_ends
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.steps import StepAudit, pick_sides
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.config import AuditConfig
from mqslam.core import se2
from mqslam.report.formatting import ABSENT, describe_motion, format_length, format_three_digits

WORST = 10  # places that a page shows
_TIMES: Final = {
    "jump": "at {t1:.1f} s",
    "span": "{t0:.1f} s to {t1:.1f} s",
    "revisit": "{t0:.1f} s and {t1:.1f} s",
}  # when a pair of stretches was seen, in words
_SPREAD_M = 50.0  # path between two places of one kind on a page, so that one bad stretch does not fill it


@dataclass(frozen=True, slots=True)
class Spot:
    """A window, or a torn jump, span or revisit, as a page shows it.

    Args:
        kind: what it is.
        time: when it was, in words.
        t0, t1: begin and end of a window, or what was seen earlier and later [s] since the recording's start.
        pose: (3,) of the sensor at the window's middle, or at what was seen later, world frame.
        sweep: number of the sweep at that pose.
        stretches: numbers of the sweeps of a window, or of those that were earlier and of those that were later.
        off_m: how far the correction moves a window's points or those after a jump (root mean square), or the later pose,
            in metres.
        correction: (3,) in the frame of the pose [m, m, rad].
        inflation: the correction in units of its covariance, squared; None for a jump, which is judged against other steps.
        torn: whether it counts as torn.
        verdict: whether it is torn, or why that is not known.
        text: size and direction of the correction, in words.
        unknown: whether nothing could be decided about it.
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
    verdict: str
    text: str
    unknown: bool = False

    @property
    def place(self) -> str:
        """Where it is."""
        return f"({round(self.pose[0])}, {round(self.pose[1])}) m".replace("-", "−")

    @property
    def title(self) -> str:
        """What, when and where it is."""
        return f"{self.kind} {self.time} at {self.place}"

    @property
    def inflation_text(self) -> str:
        """The inflation, or a dash where there is none."""
        return ABSENT if self.inflation is None else format_three_digits(self.inflation)


def find_worst_spots(sweeps: Sweeps, audit: Audit, settings: AuditConfig, count: int = WORST) -> tuple[Spot, ...]:
    """Returns the torn places that are off the most, then the windows of the largest inflation, well apart.

    Args:
        sweeps: what was judged.
        audit: its judgement.
        settings: of the audit.
        count: how many places at most.
    """
    spots = [*spots_of_torn_pairs(sweeps, audit, settings), *map(spot_of_window, audit.windows)]
    chosen: list[Spot] = []
    for spot in sorted(spots, key=rank_spot, reverse=True):
        if len(chosen) == count:
            break
        if all(_are_apart(sweeps, spot, other) for other in chosen):
            chosen.append(spot)
    return tuple(chosen)


def rank_spot(spot: Spot) -> tuple[bool, float]:
    """Ranks torn places by how far they are off, and the others by inflation, because directions may be unobserved."""
    return spot.torn, spot.off_m if spot.torn or spot.inflation is None else spot.inflation


def spot_of_window(window: WindowAudit) -> Spot:
    """Returns a window as a spot."""
    bend = window.bend
    verdict = "torn" if window.torn else "not torn"
    if window.undecided is not None:
        verdict = f"undecided: {window.undecided}"
    motion, size = describe_motion(bend.correction), format_length(bend.size_m)
    text = f"Best with the window's end moved {motion} against its begin, which moves its points by {size}."
    known = "" if window.torn else f", {verdict}"
    return Spot(
        kind="window",
        time=f"{window.t0:.1f} s to {window.t1:.1f} s",
        t0=window.t0,
        t1=window.t1,
        pose=window.pose,
        sweep=(window.begin + window.end) // 2,
        stretches=(range(window.begin, window.end),),
        off_m=bend.size_m,
        correction=bend.correction,
        inflation=bend.inflation,
        torn=window.torn,
        verdict=verdict,
        text=f"{text} Inflation {format_three_digits(bend.inflation)}{known}.",
        unknown=window.undecided is not None,
    )


def spots_of_torn_pairs(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> list[Spot]:
    """Returns the jumps, the torn spans and the torn revisits as spots.

    Args:
        sweeps: what was judged.
        audit: its judgement.
        settings: of the audit.
    """
    jumps = [_spot_of_jump(sweeps, jump) for jump in audit.jumps]
    spans = [_spot_of_span(sweeps, span) for span in audit.spans if span.torn]
    return jumps + spans + [_spot_of_revisit(sweeps, r.revisit, settings) for r in audit.revisits if r.torn]


def _spot_of_jump(sweeps: Sweeps, jump: StepAudit) -> Spot:
    """Returns a jump as a spot."""
    laid = jump.laid
    motion, size = describe_motion(laid.offset), format_length(laid.size_m)
    return _spot_of_pair(
        sweeps,
        (laid.earlier, laid.later),
        pick_sides(laid.later),
        kind="jump",
        off_m=laid.size_m,
        correction=laid.offset,
        text=f"What was seen after it fits where it is moved {motion}, which moves its points by {size}"
        f"; {_describe_match(laid.matched)}.",
    )


def _spot_of_span(sweeps: Sweeps, span: SpanAudit) -> Spot:
    """Returns a torn span as a spot."""
    pair = span.laid.earlier, span.laid.later
    inflation = float(se2.normalise(span.offset[None], span.covariance[None])[0])
    return _spot_of_pair(
        sweeps,
        pair,
        pick_ends(pair),
        kind="span",
        off_m=span.distance_m,
        correction=span.offset,
        inflation=inflation,
        text=_describe_fit("The end of the span", span.distance_m, span.offset, span.laid.matched, inflation),
    )


def _spot_of_revisit(sweeps: Sweeps, revisit: Revisit, settings: AuditConfig) -> Spot:
    """Returns a torn revisit as a spot."""
    pair = revisit.earlier, revisit.later
    return _spot_of_pair(
        sweeps,
        pair,
        pick_passes(sweeps, *pair, settings),
        kind="revisit",
        off_m=revisit.distance_m,
        correction=revisit.offset,
        inflation=revisit.inflation,
        text=_describe_fit("The later pass", revisit.distance_m, revisit.offset, revisit.matched, revisit.inflation),
    )


def _spot_of_pair(
    sweeps: Sweeps,
    pair: tuple[int, int],
    stretches: tuple[Sequence[int], Sequence[int]],
    *,
    kind: str,
    off_m: float,
    correction: se2.Array,
    text: str,
    inflation: float | None = None,
) -> Spot:
    """Returns a torn pair of stretches, laid in the frames of a pair of sweeps, as a spot."""
    t0, t1 = sweeps.times[list(pair)].tolist()
    return Spot(
        kind=kind,
        time=_TIMES[kind].format(t0=t0, t1=t1),
        t0=t0,
        t1=t1,
        pose=sweeps.poses[pair[1]],
        sweep=pair[1],
        stretches=stretches,
        off_m=off_m,
        correction=correction,
        inflation=inflation,
        torn=True,
        verdict="torn",
        text=text,
    )


def _describe_fit(what: str, off_m: float, correction: se2.Array, matched: float, inflation: float) -> str:
    """Returns in words where the later stretch fits."""
    fit = f"{what} fits {format_length(off_m)} from where the trajectory has it, moved {describe_motion(correction)}"
    return f"{fit}; {_describe_match(matched)}. Inflation {format_three_digits(inflation)}."


def _describe_match(matched: float) -> str:
    """Returns in words how well two stretches fit once the later one is moved."""
    return f"{100.0 * matched:.0f} % of its points then lie on what was seen before"


def _are_apart(sweeps: Sweeps, a: Spot, b: Spot) -> bool:
    """Returns whether a page may show both places."""
    if a.kind != b.kind:
        return True
    if a.kind == "window" and a.stretches[0][0] <= b.stretches[0][-1] + 1 and b.stretches[0][0] <= a.stretches[0][-1] + 1:
        return False
    return bool(abs(sweeps.travelled[a.sweep] - sweeps.travelled[b.sweep]) > _SPREAD_M)
