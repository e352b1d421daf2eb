"""What an audit could not match, where that is, and in which file to look for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.core import se2
from mqslam.core.wording import count_of

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
