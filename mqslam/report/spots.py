"""The worst places of an audited map, and in words what would mend them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mqslam.audit.judge import Audit
from mqslam.audit.revisits import RevisitAudit
from mqslam.audit.sweeps import Sweeps
from mqslam.audit.windows import WindowAudit
from mqslam.core import se2

WORST = 10  # places that are shown
_SPREAD_M = 50.0  # path between two places of one kind that are shown
_STILL_M, _STILL_RAD = 5e-4, 1e-4  # smaller parts of a correction are not spoken of


@dataclass(frozen=True, slots=True)
class Spot:
    """A window or a revisit that is off.

    Args:
        found: what was judged.
        t0, t1: begin and end of the window, or the earlier and the later pass [s] since the recording's start.
        pose: (3,) of the sensor at the window's middle or at the later pass, world frame.
        sweep: the one at that pose.
        off_m: how far the correction moves a window's points (root mean square) or a revisit's later pass [m].
        correction: (3,) in the frame of the pose [m, m, rad].
        inflation: the correction in units of its covariance, squared.
        torn: whether it counts as torn.
    """

    found: WindowAudit | RevisitAudit
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
        """What it is."""
        return "window" if isinstance(self.found, WindowAudit) else "revisit"

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
        """All of that."""
        return f"{self.kind} {self.time} at {self.place}"

    @property
    def text(self) -> str:
        """Size and direction of the correction."""
        motion, size = direction(self.correction), length(self.off_m)
        if isinstance(self.found, WindowAudit):
            said = f"Best with the window's end moved {motion} against its begin, which moves its points by {size}."
        else:
            matched = f"{100.0 * self.found.revisit.matched:.0f} % of its points then lie on the earlier one"
            said = f"The later pass fits {size} from where the trajectory has it, moved {motion}; {matched}."
        return f"{said} Inflation {three(self.inflation)}" + ("." if self.torn else ", not torn.")


def worst_spots(sweeps: Sweeps, audit: Audit, count: int = WORST) -> tuple[Spot, ...]:
    """The torn windows and revisits that are off the most, then the windows of the largest inflation, well apart."""
    spots = [of_revisit(sweeps, r) for r in audit.revisits if r.torn] + [of_window(w) for w in audit.windows]
    chosen: list[Spot] = []
    for spot in sorted(spots, key=rank, reverse=True):
        if len(chosen) == count:
            break
        if all(_apart(sweeps, spot, other) for other in chosen):
            chosen.append(spot)
    return tuple(chosen)


def rank(spot: Spot) -> tuple[bool, float]:
    """Torn places by how far they are off, then the others by inflation: what is not observed may be off by far."""
    return spot.torn, spot.off_m if spot.torn else spot.inflation


def direction(motion: Iterable[float]) -> str:
    """A planar motion (x [m], y [m], yaw [rad]) in words, as one who drives would say it."""
    x, y, yaw = motion
    parts = []
    if abs(x) >= _STILL_M:
        parts.append(f"{length(abs(x))} {'ahead' if x > 0 else 'back'}")
    if abs(y) >= _STILL_M:
        parts.append(f"{length(abs(y))} {'left' if y > 0 else 'right'}")
    if abs(yaw) >= _STILL_RAD:
        parts.append(f"turned {np.rad2deg(abs(yaw)):.2g}° {'left' if yaw > 0 else 'right'}")
    return ", ".join(parts) or "nowhere"


def length(metres: float) -> str:
    """A length as text, in millimetres below a decimetre."""
    return f"{metres:.2f} m" if metres >= 0.1 else f"{1e3 * metres:.0f} mm"


def three(value: float) -> str:
    """A number as text, with three digits that count."""
    return f"{float(f'{value:.3g}'):,.10g}"


def of_window(window: WindowAudit) -> Spot:
    """A window as a spot."""
    bend = window.bend
    middle = (window.begin + window.end) // 2
    return Spot(window, window.t0, window.t1, window.pose, middle, bend.size_m, bend.correction, bend.inflation, window.torn)


def of_revisit(sweeps: Sweeps, found: RevisitAudit) -> Spot:
    """A revisit as a spot."""
    revisit = found.revisit
    t0, t1 = float(sweeps.times[revisit.earlier]), float(sweeps.times[revisit.later])
    pose = sweeps.poses[revisit.later]
    return Spot(found, t0, t1, pose, revisit.later, revisit.distance_m, revisit.offset, revisit.inflation, found.torn)


def _apart(sweeps: Sweeps, a: Spot, b: Spot) -> bool:
    if isinstance(a.found, WindowAudit) and isinstance(b.found, WindowAudit):
        if a.found.begin <= b.found.end and b.found.begin <= a.found.end:
            return False
    elif a.kind != b.kind:
        return True
    return bool(abs(sweeps.travelled[a.sweep] - sweeps.travelled[b.sweep]) > _SPREAD_M)
