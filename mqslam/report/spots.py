"""The worst places of an audited map, and what would correct them, in words."""

from __future__ import annotations

from dataclasses import dataclass

from mqslam.auditing.judge import Audit
from mqslam.auditing.revisits import RevisitAudit
from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.windows import WindowAudit
from mqslam.core import se2
from mqslam.report.formatting import describe_motion, format_length, format_three_digits

WORST = 10  # places that a page shows
_SPREAD_M = 50.0  # path between two places of one kind on a page, so that one bad stretch does not fill it


@dataclass(frozen=True, slots=True)
class Spot:
    """A window or a revisit as a page shows it.

    Args:
        judged: the window or revisit.
        t0, t1: begin and end of the window, or the earlier and the later pass [s] since the recording's start.
        pose: (3,) of the sensor at the window's middle or at the later pass, world frame.
        sweep: number of the sweep at that pose.
        off_m: how far the correction moves a window's points (root mean square) or a revisit's later pass [m].
        correction: (3,) in the frame of the pose [m, m, rad].
        inflation: the correction in units of its covariance, squared.
        torn: whether it counts as torn.
    """

    judged: WindowAudit | RevisitAudit
    t0: float
    t1: float
    pose: se2.Array
    sweep: int
    off_m: float
    correction: se2.Array
    inflation: float
    torn: bool

    @property
    def kind(self) -> str:
        """What it is: window or revisit."""
        return "window" if isinstance(self.judged, WindowAudit) else "revisit"

    @property
    def time(self) -> str:
        """When it was."""
        between = "to" if self.kind == "window" else "and"
        return f"{self.t0:.1f} s {between} {self.t1:.1f} s"

    @property
    def place(self) -> str:
        """Where it is."""
        return f"({round(self.pose[0])}, {round(self.pose[1])}) m".replace("-", "−")

    @property
    def title(self) -> str:
        """What, when and where it is."""
        return f"{self.kind} {self.time} at {self.place}"

    @property
    def text(self) -> str:
        """Size and direction of the correction."""
        motion, size = describe_motion(self.correction), format_length(self.off_m)
        if isinstance(self.judged, WindowAudit):
            text = f"Best with the window's end moved {motion} against its begin, which moves its points by {size}."
        else:
            matched = f"{100.0 * self.judged.revisit.matched:.0f} % of its points then lie on the earlier one"
            text = f"The later pass fits {size} from where the trajectory has it, moved {motion}; {matched}."
        verdict = "" if self.torn else f", {self.verdict}"
        return f"{text} Inflation {format_three_digits(self.inflation)}{verdict}."

    @property
    def verdict(self) -> str:
        """Whether it is torn, or why that is not known."""
        undecided = self.judged.undecided if isinstance(self.judged, WindowAudit) else None
        if undecided is not None:
            return f"undecided: {undecided}"
        return "torn" if self.torn else "not torn"


def find_worst_spots(sweeps: Sweeps, audit: Audit, count: int = WORST) -> tuple[Spot, ...]:
    """Returns the torn places that are off the most, then the windows of the largest inflation, well apart.

    Args:
        sweeps: what was judged.
        audit: the windows and revisits, judged.
        count: how many places at most.
    """
    spots = [spot_of_revisit(sweeps, r) for r in audit.revisits if r.torn] + [spot_of_window(w) for w in audit.windows]
    chosen: list[Spot] = []
    for spot in sorted(spots, key=rank_spot, reverse=True):
        if len(chosen) == count:
            break
        if all(_are_apart(sweeps, spot, other) for other in chosen):
            chosen.append(spot)
    return tuple(chosen)


def rank_spot(spot: Spot) -> tuple[bool, float]:
    """Ranks torn places by how far they are off, and the others by inflation, because directions may be unobserved."""
    return spot.torn, spot.off_m if spot.torn else spot.inflation


def spot_of_window(window: WindowAudit) -> Spot:
    """Returns a window as a spot."""
    bend = window.bend
    middle = (window.begin + window.end) // 2
    return Spot(window, window.t0, window.t1, window.pose, middle, bend.size_m, bend.correction, bend.inflation, window.torn)


def spot_of_revisit(sweeps: Sweeps, judged: RevisitAudit) -> Spot:
    """Returns a revisit as a spot."""
    revisit = judged.revisit
    t0, t1 = float(sweeps.times[revisit.earlier]), float(sweeps.times[revisit.later])
    pose = sweeps.poses[revisit.later]
    return Spot(judged, t0, t1, pose, revisit.later, revisit.distance_m, revisit.offset, revisit.inflation, judged.torn)


def _are_apart(sweeps: Sweeps, a: Spot, b: Spot) -> bool:
    """Returns whether a page may show both places."""
    if isinstance(a.judged, WindowAudit) and isinstance(b.judged, WindowAudit):
        if a.judged.begin <= b.judged.end and b.judged.begin <= a.judged.end:
            return False
    elif a.kind != b.kind:
        return True
    return bool(abs(sweeps.travelled[a.sweep] - sweeps.travelled[b.sweep]) > _SPREAD_M)
