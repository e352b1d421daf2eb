"""What every reader of a text file must do: name a file that is missing, empty or no text, and say what to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mqslam.errors import DataError
from mqslam.formats.covariances import read_covariances
from mqslam.formats.graphs.g2o import read_edges, read_g2o
from mqslam.formats.recordings.radiate import read_listing
from mqslam.formats.sensors import read_fixes, read_gyroscope
from mqslam.formats.trajectories import read_odometry, read_trajectory
from mqslam.formats.tum import read_tum

READERS: dict[str, Callable[[Path], Any]] = {
    "tum": read_tum,
    "trajectory": read_trajectory,
    "odometry": read_odometry,
    "gyroscope": read_gyroscope,
    "fixes": lambda path: read_fixes(path, 0),
    "covariances": read_covariances,
    "g2o": read_g2o,
    "edges": read_edges,
    "frames": read_listing,
}


@pytest.fixture(params=READERS)
def read(request: pytest.FixtureRequest) -> Callable[[Path], Any]:
    return READERS[request.param]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "does not exist"),
        (b"\xff\xfe\x00\x81", r"is not a readable text file \(not UTF-8\)"),
        (b"\xff\xfe\x00", r"is not a readable text file \(not UTF-8\)"),
    ],
)
def test_a_file_that_is_missing_or_no_text_is_named(
    tmp_path: Path, read: Callable[[Path], Any], content: bytes | None, problem: str
) -> None:
    if content is not None:
        (tmp_path / "some.txt").write_bytes(content)
    with pytest.raises(DataError, match=rf"some\.txt: {problem}") as caught:
        read(tmp_path / "some.txt")
    assert caught.value.remedy and "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "\n\n", "# nothing, but words\n"])
def test_a_file_of_nothing_is_named(tmp_path: Path, read: Callable[[Path], Any], text: str) -> None:
    (tmp_path / "some.txt").write_text(text)
    if read is read_edges:
        assert read(tmp_path / "some.txt") == ([], 0)
        return
    with pytest.raises(DataError, match=r"some\.txt: "):
        read(tmp_path / "some.txt")


@pytest.mark.parametrize("read", [read_tum, read_trajectory, read_odometry, read_g2o])
def test_a_file_that_is_missing_is_sought_beside_its_path(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    (tmp_path / "trajectory.tum").touch()
    with pytest.raises(DataError, match=r"trajektory\.tum: does not exist; did you mean trajectory\.tum\?"):
        read(tmp_path / "trajektory.tum")
    with pytest.raises(DataError, match="does not exist; check the path"):
        read(tmp_path / "away" / "trajectory.tum")
