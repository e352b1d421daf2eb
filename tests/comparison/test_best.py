"""The best row of a comparison, and the sentences that say why."""

from __future__ import annotations

import pytest

from mqslam.auditing.verdict import Share, VerdictStatus
from mqslam.comparison.best import Best, Standing, find_best

CONFIDENCE = 0.95
NOTHING = Share(0, 0)


def standing(name: str, drift: float | None = None, ate: float | None = None, **torn: Share) -> Standing:
    return Standing(name, drift, ate, torn.get("windows", NOTHING), torn.get("revisits", NOTHING))


def test_the_verdict_decides_where_nothing_else_does() -> None:
    shares = Share(1, 20), NOTHING
    rows = [
        Standing(name, None, None, *shares, status)
        for name, status in (("a", VerdictStatus.FAIL), ("b", VerdictStatus.PASS))
    ]
    best = best_of(*rows)
    assert best.rows == ("b",) and best.sentence.startswith("b is best: its verdict is pass, against fail for a.")


def test_a_row_that_could_not_be_judged_is_named_where_the_others_verdict_would_decide() -> None:
    rows = [
        Standing(name, None, None, Share(0, 6), NOTHING, status)
        for name, status in (("psi", VerdictStatus.NOT_JUDGED), ("gps", VerdictStatus.FAIL))
    ]
    best = best_of(*rows)
    assert best.rows == ("psi", "gps") and best.sentence.startswith("psi and gps cannot be told apart.")
    said = "The verdict is fail for gps, but psi could not be judged, so that verdicts do not decide."
    assert best.sentence.endswith(said)


def best_of(*rows: Standing) -> Best:
    best = find_best(rows)
    assert best is not None
    return best


# a drive of which psi per point, 0.0924, 0.0886 and 0.0912, made KISS-ICP look best
DRIVE = (("psi", 0.197, 1), ("kiss_icp", 0.242, 50), ("open3d_icp", 0.284, 37))
CLEAN = {"windows": Share(0, 50), "revisits": Share(0, 4)}
CASES = {
    "drift where there is truth": (
        [standing(name, drift, 0.5, windows=Share(torn, 129)) for name, drift, torn in DRIVE],
        ("psi",),
        "drift",
        "psi is best: its drift is 0.197 %, against 0.242 % for kiss_icp and 0.284 % for open3d_icp.",
    ),
    "torn windows without truth": (
        [standing(name, windows=Share(torn, 129)) for name, _, torn in DRIVE],
        ("psi",),
        "share of torn windows",
        "psi is best: its share of torn windows is 0.8 % (1 of 129), "
        "against 28.7 % (37 of 129) for open3d_icp and 38.8 % (50 of 129) for kiss_icp.",
    ),
    "ATE where drift reads the same": (
        [standing("a", 0.1972, 0.61), standing("b", 0.1968, 0.52), standing("c", 0.284, 0.1)],
        ("b",),
        "ATE",
        "b is best: its ATE is 0.520 m, against 0.610 m for a. "
        "The drift of a and b is the same: 0.197 %. It is 0.284 % for c, which is worse.",
    ),
    "ATE on a path that is too short for drift": (
        [standing("a", None, 0.2), standing("b", None, 0.1)],
        ("b",),
        "ATE",
        "b is best: its ATE is 0.100 m, against 0.200 m for a.",
    ),
    "no truth that judges one row only": (
        [standing("a", 0.1, 0.1, windows=Share(60, 100)), standing("b", windows=Share(1, 100))],
        ("b",),
        "share of torn windows",
        "b is best: its share of torn windows is 1.0 % (1 of 100), against 60.0 % (60 of 100) for a.",
    ),
    "revisits where windows differ by chance": (
        [
            standing("a", windows=Share(1, 20), revisits=Share(18, 20)),
            standing("b", windows=Share(3, 20), revisits=Share(0, 20)),
        ],
        ("b",),
        "share of torn revisits",
        "b is best: its share of torn revisits is 0.0 % (0 of 20), against 90.0 % (18 of 20) for a. "
        "The difference between a and b in the share of torn windows may be chance: 5.0 % (1 of 20) and 15.0 % (3 of 20).",
    ),
    "nothing among rows that are alike": (
        [standing("a", **CLEAN), standing("b", **CLEAN), standing("c", windows=Share(40, 50))],
        ("a", "b"),
        None,
        "a and b cannot be told apart. The share of torn windows of a and b is the same: 0.0 % (0 of 50). "
        "It is 80.0 % (40 of 50) for c, which is worse. The share of torn revisits of a and b is the same: 0.0 % (0 of 4).",
    ),
    "nothing among rows that nothing judges": (
        [standing("a"), standing("b")],
        ("a", "b"),
        None,
        "a and b cannot be told apart: no error, share or verdict is known for all of them.",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_decides_is_said_whatever_the_order_of_the_rows(case: str) -> None:
    rows, best, decided_by, sentence = CASES[case]
    assert best_of(*rows) == Best(best, decided_by, sentence)
    if decided_by is not None:
        assert best_of(*reversed(rows)).rows == best


@pytest.mark.parametrize(("total", "told"), [(20, False), (2000, True)])
def test_the_same_shares_are_told_apart_only_by_enough_windows(total: int, told: bool) -> None:
    best = best_of(standing("a", windows=Share(total // 20, total)), standing("b", windows=Share(3 * total // 20, total)))
    assert (best.rows == ("a",)) is told
    assert ("cannot be told apart" in best.sentence) is not told


def test_one_row_needs_no_winner() -> None:
    assert find_best([standing("a", 0.1, 0.1)]) is None
    assert find_best([]) is None
