"""Covariances keep their stamps to the microsecond and their terms to twelve digits through their file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mqslam.core.trajectory import Trajectory
from mqslam.errors import DataError
from mqslam.formats.covariances import StampedCovariances, list_known, read_covariances, write_covariances

NO_ROW = "line 2 is not a whole stamp [us] and six finite numbers"
HEAD = "stamp_us,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw"
ROW = "1547131046353776,0.04,0.01,0.001,0.09,-0.002,0.0001"


def test_covariances_are_read_back_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(50, 3, 3)) * 10.0 ** rng.uniform(-4.0, 4.0, (50, 3, 1))
    given = StampedCovariances(1_547_131_046_353_776 + 250_001 * np.arange(50), roots @ roots.transpose(0, 2, 1))
    write_covariances(tmp_path / "c.csv", given)
    back = read_covariances(tmp_path / "c.csv")
    np.testing.assert_array_equal(back.stamps_us, given.stamps_us)
    np.testing.assert_allclose(back.covariances, given.covariances, rtol=1e-11)
    np.testing.assert_array_equal(back.covariances, back.covariances.transpose(0, 2, 1))


def test_a_row_holds_the_upper_triangle_of_the_covariance(tmp_path: Path) -> None:
    (tmp_path / "c.csv").write_text(f"{HEAD}\n{ROW}\n")
    (covariance,) = read_covariances(tmp_path / "c.csv").covariances
    np.testing.assert_array_equal(covariance, [[0.04, 0.01, 0.001], [0.01, 0.09, -0.002], [0.001, -0.002, 0.0001]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "does not begin with the columns stamp_us,cov_xx"),
        ("t0,t1,dx,dy\n0,1,2,3\n", "does not begin with the columns stamp_us,cov_xx"),
        (f"{HEAD}\n", "holds no covariances"),
        (f"{HEAD}\n{ROW}\n{ROW}\n", "the stamp of line 3 is not later than the stamp before"),
        (f"{HEAD}\n{ROW},1\n", NO_ROW),
        (f"{HEAD}\n{ROW.replace('0.04', 'nan')}\n", NO_ROW),
        (f"{HEAD}\n9999{ROW}\n", NO_ROW),
        (f"{HEAD}\n{ROW.replace('0.04', 'much')}\n", NO_ROW),
        (f"{HEAD}\n{ROW.replace('1547131046353776', '1547131046.353776')}\n", NO_ROW),
        (f"{HEAD}\n{ROW.replace('0.04', '-0.04')}\n", "line 2 has a variance that is not positive"),
        (f"{HEAD}\n{ROW.replace('-0.002', '1e308')}\n", "the terms of line 2 do not form a covariance"),
        (f"{HEAD}\n{ROW.replace('0.01', '0.07')}\n", "the terms of line 2 do not form a covariance"),
    ],
)
def test_a_file_of_anything_else_is_refused_with_its_line(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(DataError) as caught:
        read_covariances(tmp_path / "c.csv")
    assert problem in str(caught.value) and "give covariances.csv as a run writes it" in str(caught.value)


@pytest.mark.parametrize(
    ("summary", "of_first_pose"), [(None, True), ('{"verdict": {}}', True), ('{"median_sigma": {"along_m": 0.1}}', False)]
)
def test_those_of_a_localisation_are_along_the_axes_of_its_map(
    tmp_path: Path, summary: str | None, of_first_pose: bool
) -> None:
    (tmp_path / "covariances.csv").write_text(f"{HEAD}\n{ROW}\n")
    if summary is not None:
        (tmp_path / "summary.json").write_text(summary)
    given = read_covariances(tmp_path / "covariances.csv")
    assert given.of_first_pose is of_first_pose
    track = Trajectory(given.stamps_us, np.array([[3.0, 4.0, np.pi / 2.0]]))
    ((_, covariance),) = list_known(track, given)
    assert covariance[0, 0] == pytest.approx(0.09 if of_first_pose else 0.04)


def test_a_damaged_summary_beside_covariances_is_named(tmp_path: Path) -> None:
    (tmp_path / "covariances.csv").write_text(f"{HEAD}\n{ROW}\n")
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(DataError, match=r"summary\.json: is damaged"):
        read_covariances(tmp_path / "covariances.csv")
