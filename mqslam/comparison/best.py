"""Finds the best row (front end or given trajectory) of a comparison, and names the criterion that decides.

Errors against ground truth decide first, then the shares of torn windows and of torn revisits, then the verdicts. psi per
point over neighbours in time decides nothing, since it is as small for a map that bends slowly as for a correct map.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from mqslam.auditing.revisits import share_torn_revisits
from mqslam.auditing.verdict import GRAVEST_FIRST, Share, VerdictStatus
from mqslam.auditing.windows.windows import share_torn
from mqslam.comparison.judgement import JudgedRow
from mqslam.core.wording import join_words

_FIGURES: Final = ".3f"  # errors with the same text in the table count as equal


@dataclass(frozen=True, slots=True)
class Standing:
    """The errors and shares by which a row is ranked.

    Args:
        name: name of the row.
        drift_percent: mean translation error [%] of KITTI's segments against ground truth; None where it is not known.
        ate_rmse_m: position error [m] against ground truth, root mean square; None where it is not known.
        windows: share of torn windows among the windows that are decided (see `WindowAudit`).
        revisits: share of torn revisits among the revisits that are sure (see `RevisitAudit`).
        verdict: the verdict on its map.
    """

    name: str
    drift_percent: float | None
    ate_rmse_m: float | None
    windows: Share
    revisits: Share
    verdict: VerdictStatus = VerdictStatus.NOT_JUDGED

    @classmethod
    def of(cls, judged: JudgedRow) -> Standing:
        """Returns the errors and shares by which a judged row is ranked."""
        return cls(
            name=judged.row.name,
            drift_percent=None if judged.after is None else judged.after.drift_percent,
            ate_rmse_m=None if judged.after is None else judged.after.ate_rmse_m,
            windows=share_torn(judged.audit.windows),
            revisits=share_torn_revisits(judged.audit.revisits),
            verdict=judged.audit.verdict.status,
        )


@dataclass(frozen=True, slots=True)
class Best:
    """The best row of a comparison, or several rows between which no criterion decides.

    Args:
        rows: name of the best row, or of each row that may be the best.
        decided_by: the criterion that rules out the last of the other rows; None where no criterion decides.
        sentence: the result in words, with the figures that decide.
    """

    rows: tuple[str, ...]
    decided_by: str | None
    sentence: str


class _Figure(NamedTuple):
    """A row's value of one criterion, the range in which chance may put the value, and the value's text for a sentence."""

    name: str
    value: float
    low: float
    high: float
    text: str


class _Tie(NamedTuple):
    """The result of a criterion that does not decide: the rows that may be equal, and the rows that are worse."""

    criterion: str
    alike: list[_Figure]
    worse: list[_Figure]


def find_best(rows: Sequence[Standing]) -> Best | None:
    """Finds the best row by drift, ATE, share of torn windows, share of torn revisits and verdict, in this order.

    A criterion keeps the row with the smallest value and all rows that do not differ from it, and the next criterion decides
    among these rows. Two errors differ if they have different text in the table. Two shares differ if their ranges do not
    overlap. A criterion is skipped if one of the remaining rows has no value for it.

    Args:
        rows: errors and shares of the rows that ran.

    Returns:
        The best row, or the rows between which no criterion decides; None for fewer than two rows.
    """
    if len(rows) < 2:
        return None
    left = list(rows)
    ties: list[_Tie] = []
    for criterion, measure in CRITERIA.items():
        known = [figure for row in left if (figure := measure(row)) is not None]
        if len(known) < len(left):
            continue
        figures = sorted(known, key=lambda figure: figure.value)
        alike = [figure for figure in figures if figure.low <= figures[0].high]
        worse = [figure for figure in figures if figure not in alike]
        if len(alike) == 1:
            best, others = alike[0], join_words([f"{other.text} for {other.name}" for other in worse])
            sentence = f"{best.name} is best: its {criterion} is {best.text}, against {others}."
            return Best((best.name,), criterion, " ".join([sentence, *map(_explain, ties)]))
        ties.append(_Tie(criterion, alike, worse))
        left = [row for row in left if row.name in {figure.name for figure in alike}]
    names = tuple(row.name for row in left)
    undecided = f"{join_words(names)} cannot be told apart"
    if not ties:
        undecided += ": no error, share or verdict is known for all of them"
    return Best(names, None, " ".join([f"{undecided}.", *map(_explain, ties), *_explain_verdicts(left)]))


def _state_error(name: str, error: float | None, unit: str) -> _Figure | None:
    """Returns an error against ground truth as a figure without a range, rounded as in the table; None if not known."""
    if error is None:
        return None
    text = f"{error:{_FIGURES}}"
    return _Figure(name, float(text), float(text), float(text), f"{text} {unit}")


def _state_share(name: str, share: Share) -> _Figure | None:
    """Returns a share as a figure with its exact binomial confidence range; None where nothing was counted."""
    if not share.total:
        return None
    value = share.count / share.total
    text = f"{100.0 * value:.1f} % ({share.count} of {share.total})"
    return _Figure(name, value, share.lower_bound(), share.upper_bound(), text)


def _state_verdict(name: str, verdict: VerdictStatus) -> _Figure | None:
    """Returns a verdict as a figure, which is larger for a graver verdict; None where the map could not be judged."""
    if verdict is VerdictStatus.NOT_JUDGED:
        return None
    value = -float(GRAVEST_FIRST.index(verdict))
    return _Figure(name, value, value, value, str(verdict))


CRITERIA: Final[dict[str, Callable[[Standing], _Figure | None]]] = {
    "drift": lambda row: _state_error(row.name, row.drift_percent, "%"),
    "ATE": lambda row: _state_error(row.name, row.ate_rmse_m, "m"),
    "share of torn windows": lambda row: _state_share(row.name, row.windows),
    "share of torn revisits": lambda row: _state_share(row.name, row.revisits),
    "verdict": lambda row: _state_verdict(row.name, row.verdict),
}
"""The criteria that rank rows, the first to decide first; each states the figure of a row, or None if it is not known."""


def _explain_verdicts(rows: Sequence[Standing]) -> list[str]:
    """Returns a list of one sentence, that verdicts decide nothing, if only some rows were judged; else an empty list."""
    unjudged = [row.name for row in rows if row.verdict is VerdictStatus.NOT_JUDGED]
    if not unjudged or len(unjudged) == len(rows):
        return []
    others = join_words([f"{row.verdict} for {row.name}" for row in rows if row.name not in unjudged])
    return [f"The verdict is {others}, but {join_words(unjudged)} could not be judged, so that verdicts do not decide."]


def _explain(tie: _Tie) -> str:
    """Returns in words why a criterion does not decide between some rows, and which other rows it shows to be worse."""
    names, texts = join_words([figure.name for figure in tie.alike]), [figure.text for figure in tie.alike]
    if len(set(texts)) == 1:
        said = f"The {tie.criterion} of {names} is the same: {texts[0]}."
    else:
        said = f"The difference between {names} in the {tie.criterion} may be chance: {join_words(texts)}."
    if tie.worse:
        said += f" It is {join_words([f'{figure.text} for {figure.name}' for figure in tie.worse])}, which is worse."
    return said
