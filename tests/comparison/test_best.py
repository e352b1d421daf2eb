"""The best row of a comparison, and the sentences that say why."""

from __future__ import annotations

import pytest

from mqslam.auditing.verdict import Share
from mqslam.comparison.best import Best, Standing, find_best

CONFIDENCE = 0.95
NOTHING = Share(0, 0)


def standing(name: str, drift: float | None = None, ate: float | None = None, **torn: Share) -> Standing:
    return Standing(name, drift, ate, torn.get("windows", NOTHING), torn.get("revisits", NOTHING))


def best_of(*rows: Standing) -> Best:
    best = find_best(rows)
    assert best is not None
    return best


# a drive of which psi per point, 0.0924, 0.0886 and 0.0912, made KISS-ICP look best
DRIVE = (("psi", 0.197, 1), ("kiss_icp", 0.242, 50), ("open3d_icp", 0.284, 37))


def test_drift_decides_where_there_is_truth() -> None:
    best = best_of(*(standing(name, drift, 0.5, windows=Share(torn, 129)) for name, drift, torn in DRIVE))
    assert (best.rows, best.decided_by) == (("psi",), "drift")
    assert best.sentence == "psi is best: its drift is 0.197 %, against 0.242 % for kiss_icp and 0.284 % for open3d_icp."


def test_torn_windows_decide_without_truth() -> None:
    best = best_of(*(standing(name, windows=Share(torn, 129)) for name, _, torn in DRIVE))
    assert (best.rows, best.decided_by) == (("psi",), "share of torn windows")
    assert best.sentence == (
        "psi is best: its share of torn windows is 0.8 % (1 of 129), "
        "against 28.7 % (37 of 129) for open3d_icp and 38.8 % (50 of 129) for kiss_icp."
    )


def test_the_order_of_the_rows_decides_nothing() -> None:
    rows = [standing(name, windows=Share(torn, 129)) for name, _, torn in DRIVE]
    assert best_of(*rows) == best_of(*reversed(rows))


def test_ate_decides_where_drift_reads_the_same() -> None:
    best = best_of(standing("a", 0.1972, 0.61), standing("b", 0.1968, 0.52), standing("c", 0.284, 0.1))
    assert (best.rows, best.decided_by) == (("b",), "ATE")
    assert best.sentence == (
        "b is best: its ATE is 0.520 m, against 0.610 m for a. "
        "The drift of a and b is the same: 0.197 %. It is 0.284 % for c, which is worse."
    )


def test_ate_decides_on_a_path_that_is_too_short_for_drift() -> None:
    assert best_of(standing("a", None, 0.2), standing("b", None, 0.1)).rows == ("b",)


def test_truth_that_judges_one_row_only_decides_nothing() -> None:
    best = best_of(standing("a", 0.1, 0.1, windows=Share(60, 100)), standing("b", windows=Share(1, 100)))
    assert (best.rows, best.decided_by) == (("b",), "share of torn windows")


def test_a_difference_within_chance_leaves_it_to_the_revisits() -> None:
    best = best_of(
        standing("a", windows=Share(1, 20), revisits=Share(18, 20)),
        standing("b", windows=Share(3, 20), revisits=Share(0, 20)),
    )
    assert (best.rows, best.decided_by) == (("b",), "share of torn revisits")
    assert best.sentence == (
        "b is best: its share of torn revisits is 0.0 % (0 of 20), against 90.0 % (18 of 20) for a. "
        "The difference between a and b in the share of torn windows may be chance: 5.0 % (1 of 20) and 15.0 % (3 of 20)."
    )


@pytest.mark.parametrize(("total", "told"), [(20, False), (2000, True)])
def test_the_same_shares_are_told_apart_only_by_enough_windows(total: int, told: bool) -> None:
    best = best_of(standing("a", windows=Share(total // 20, total)), standing("b", windows=Share(3 * total // 20, total)))
    assert (best.rows == ("a",)) is told
    assert ("cannot be told apart" in best.sentence) is not told


def test_rows_that_nothing_tells_apart_are_all_named() -> None:
    clean = {"windows": Share(0, 50), "revisits": Share(0, 4)}
    best = best_of(standing("a", **clean), standing("b", **clean), standing("c", windows=Share(40, 50)))
    assert (best.rows, best.decided_by) == (("a", "b"), None)
    assert best.sentence == (
        "a and b cannot be told apart. The share of torn windows of a and b is the same: 0.0 % (0 of 50). "
        "It is 80.0 % (40 of 50) for c, which is worse. The share of torn revisits of a and b is the same: 0.0 % (0 of 4)."
    )


def test_rows_that_nothing_judges_cannot_be_told_apart() -> None:
    best = best_of(standing("a"), standing("b"))
    assert best.rows == ("a", "b")
    assert best.sentence == "a and b cannot be told apart: neither ground truth nor windows nor revisits judge all of them."


def test_one_row_needs_no_winner() -> None:
    assert find_best([standing("a", 0.1, 0.1)]) is None
    assert find_best([]) is None
