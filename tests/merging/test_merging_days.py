"""Drives of different days become one map where they share places, and none where they do not."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.commands import mqslam as command
from support.day_results import write_day
from support.reported import find_faults

import mqslam
from mqslam.commands.merge import read_part
from mqslam.core import se2
from mqslam.errors import ConfigError, DataError, EstimationError
from mqslam.execution.local_engine import LocalEngine
from mqslam.formats.maps.keyframe_folder import read_keyframes
from mqslam.formats.tum import read_tum
from mqslam.merging import changes
from mqslam.results import merge_results
from mqslam.simulator import make_street_scene
from mqslam.simulator.scene import make_box

FRAME = np.array([140.0, -75.0, 2.1])  # of the second day, which a merge must not know
VEHICLE = np.array([8.0, -44.0])  # parked beside the lane on the second day alone


@dataclass(frozen=True)
class Days:
    """Results of three drives on one round, the second of which begins elsewhere and in another frame.

    Args:
        folder: holds them, and `foreign`, a drive in another city.
        truth: (N, 3) true poses of the scans of each.
    """

    folder: Path
    truth: dict[str, NDArray[np.float64]]

    def __getitem__(self, name: str) -> Path:
        return self.folder / name


@pytest.fixture(scope="module")
def days(tmp_path_factory: pytest.TempPathFactory) -> Days:
    """The results; nobody may change them."""
    folder = tmp_path_factory.mktemp("days")
    city = make_street_scene(1, movers=0)
    parked = make_box(VEHICLE, 0.0, np.array([4.5, 1.9]), 2.0, 1.0)
    second = replace(city, walls=np.concatenate([city.walls, parked]))
    truth = {
        "monday": write_day(folder / "monday", city, 0.0, 24.0, 11),
        "friday": write_day(folder / "friday", second, 0.0, 20.0, 12, FRAME),
        "sunday": write_day(folder / "sunday", city, 10.0, 24.0, 13),
        "foreign": write_day(folder / "foreign", make_street_scene(5, movers=0), 0.0, 24.0, 14),
    }
    return Days(folder, truth)


@pytest.fixture(scope="module")
def both(days: Days) -> Path:
    """Monday and Friday as one map."""
    out = days.folder / "both"
    mqslam.merge([days["monday"], days["friday"]], out)
    return out


def read_rows(path: Path) -> list[dict[str, str]]:
    """Returns the rows of a table."""
    return list(csv.DictReader(path.read_text().splitlines()))


def find_errors(out: Path, number: int, truth: NDArray[np.float64], first: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns how far (N,) [m] a trajectory of a merge is from the truth, in the frame of the first true pose (3,)."""
    poses = read_tum(out / f"trajectory_{number}.tum").poses
    return np.asarray(np.hypot(*(poses - se2.between(first, truth))[:, :2].T))


def test_both_days_lie_in_the_frame_of_the_first(both: Path, days: Days) -> None:
    first = days.truth["monday"][0]
    for number, day in enumerate(("monday", "friday"), 1):
        assert find_errors(both, number, days.truth[day], first).max() < 1.0
    assert np.allclose(read_tum(both / "trajectory_1.tum").poses[0], 0.0, atol=1e-3)


def test_the_days_lie_on_each_other_better_than_each_on_the_truth(both: Path, days: Days) -> None:
    one, other = (read_tum(both / f"trajectory_{number}.tum").poses for number in (1, 2))
    true = se2.between(days.truth["monday"][: len(other)], days.truth["friday"])
    off = se2.between(one[: len(other)], other) - true
    assert np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2)) < 0.15


def test_every_link_is_true(both: Path, days: Days) -> None:
    keyframes = read_keyframes(both).keyframes
    truth = np.concatenate([days.truth["monday"], days.truth["friday"]])
    ends = zip(keyframes.origins.tolist(), keyframes.stamps_us.tolist(), strict=True)
    number = {(origin + 1, stamp): scan for (origin, stamp), scan in zip(ends, keyframes.scans.tolist(), strict=True)}
    rows = read_rows(both / "links.csv")
    assert len(rows) > 10
    for row in rows:
        a, b = (
            truth[number[int(row[f"{end}_recording"]), round(float(row[f"{end}_stamp"]) * 1e6)]]
            for end in ("earlier", "later")
        )
        off = np.array([float(row[name]) for name in ("x", "y", "yaw")]) - se2.between(a, b)
        assert np.hypot(off[0], off[1]) < 0.2 and abs(se2.wrap(off[2])) < 0.01


def test_psi_across_the_days_falls(both: Path) -> None:
    summary = json.loads((both / "summary.json").read_text())
    assert summary["psi"]["across_after"] < summary["psi"]["across_before"]
    assert summary["links"]["count"] == len((both / "links.csv").read_text().splitlines()) - 1


def test_a_vehicle_that_was_parked_on_one_day_is_found_and_nothing_else_large(both: Path, days: Days) -> None:
    place = se2.transform(se2.inverse(days.truth["monday"][0]), VEHICLE[None])[0]
    rows = read_rows(both / "changes.csv")
    near = [np.hypot(float(row["x"]) - place[0], float(row["y"]) - place[1]) < 4.0 for row in rows]
    assert [row["shown_by"] for row, is_near in zip(rows, near, strict=True) if is_near] == ["2"]
    assert sum(near) == 1 and len(near) <= 2


def test_a_merge_can_be_merged_again(both: Path, days: Days, tmp_path: Path) -> None:
    result = mqslam.merge([both, days["sunday"]], tmp_path / "all")
    first = days.truth["monday"][0]
    assert len(result.read_trajectories()) == 3
    for number, day in enumerate(("monday", "friday", "sunday"), 1):
        assert find_errors(tmp_path / "all", number, days.truth[day], first).max() < 1.5
    part = read_part(tmp_path / "all")
    assert part.scans == sum(len(days.truth[day]) for day in ("monday", "friday", "sunday"))


def test_three_results_are_merged_at_once_and_by_any_number_of_workers(days: Days, tmp_path: Path) -> None:
    folders = [days[day] for day in ("monday", "friday", "sunday")]
    mqslam.merge(folders, tmp_path / "one")
    with LocalEngine(2) as engine:
        mqslam.merge(folders, tmp_path / "two", work=mqslam.Work(engine))
    for name in ("links.csv", "trajectory_3.tum", "graph.g2o", "changes.csv", "map.ply"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_changes_are_looked_for_only_where_it_is_known_how_the_recordings_lie(
    days: Days, both: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = json.loads((both / "summary.json").read_text())
    assert read_rows(both / "changes.csv") and told["sureness"]["share_compared"] > 0.9
    assert 0.0 < told["sureness"]["median_m"] <= told["sureness"]["largest_m"]
    assert "objects that two recordings see lie within" in told["conclusion"]
    for module in (changes, merge_results):
        monkeypatch.setattr(module, "SURE_M", 1e-6)
    mqslam.merge([days["monday"], days["friday"]], tmp_path / "out")
    assert read_rows(tmp_path / "out" / "changes.csv") == []
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["sureness"]["share_compared"] == 0.0


def test_a_foreign_city_is_refused_and_nothing_is_left(days: Days, tmp_path: Path) -> None:
    result = command("merge", days["monday"], days["foreign"], "--out", tmp_path / "out", "-q", "--jobs", 1)
    assert result.code == 2 and "foreign: shares no place with the other recordings" in result.err
    assert list(tmp_path.iterdir()) == []


def test_one_foreign_result_among_three_is_named(days: Days, tmp_path: Path) -> None:
    with pytest.raises(EstimationError, match="foreign: shares no place"):
        mqslam.merge([days["monday"], days["foreign"], days["friday"]], tmp_path / "out")


def test_the_command_prints_what_it_has_made(days: Days, tmp_path: Path) -> None:
    result = command("merge", days["monday"], days["friday"], "--out", tmp_path / "out", "--jobs", 1)
    assert result.code == 0 and "2 recordings with" in result.out and "links" in result.out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "could not" not in page and page.count("data:image/png") >= 2
    again = command("merge", days["monday"], days["friday"], "--out", tmp_path / "out", "--jobs", 1)
    assert again.code == 2 and "exists already" in again.err


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 500)])
def test_axe_finds_no_serious_fault_in_the_page(days: Days, tmp_path: Path, scheme: str, width: int) -> None:
    mqslam.merge([days["monday"], days["friday"]], tmp_path / "out")
    assert find_faults(tmp_path / "out" / "report.html", scheme, width) == []


def test_a_single_result_and_a_repeated_one_are_refused(days: Days, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="two or more"):
        mqslam.merge([days["monday"]], tmp_path / "out")
    with pytest.raises(ConfigError, match="given twice"):
        mqslam.merge([days["monday"], days["monday"]], tmp_path / "out")
    shutil.copytree(days["monday"], tmp_path / "copy")
    with pytest.raises(DataError, match=r"holds monday\.drive, and so does .*monday"):
        mqslam.merge([days["monday"], tmp_path / "copy"], tmp_path / "out")


def test_results_of_one_recording_that_overlap_in_time_are_refused(days: Days, tmp_path: Path) -> None:
    shutil.copytree(days["monday"], tmp_path / "later")
    index = tmp_path / "later" / "keyframes" / "index.json"
    content = json.loads(index.read_text())
    (recording,) = content["recordings"]
    recording |= {"path": str(Path("monday.drive").absolute()), "start_us": recording["end_us"] - 1_000_000}
    recording["end_us"] += 1_000_000
    index.write_text(json.dumps(content))
    shown = command("merge", days["monday"], tmp_path / "later", "--out", tmp_path / "out")
    assert shown.code == 2 and "with scans of the same time; give every recording once, or parts of it that do" in shown.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("keyframes", "holds no keyframes; run the recording again"),
        ("graph.g2o", "holds no graph.g2o"),
        ("trajectory.tum", "trajectory_1.tum"),
    ],
)
def test_a_result_without_a_file_is_refused(days: Days, tmp_path: Path, name: str, message: str) -> None:
    shutil.copytree(days["friday"], tmp_path / "copy")
    victim = tmp_path / "copy" / name
    shutil.rmtree(victim) if victim.is_dir() else victim.unlink()
    with pytest.raises(DataError, match=message):
        mqslam.merge([days["monday"], tmp_path / "copy"], tmp_path / "out")


def test_a_graph_of_another_run_is_refused(days: Days, tmp_path: Path) -> None:
    shutil.copytree(days["friday"], tmp_path / "copy")
    shutil.copy(days["monday"] / "graph.g2o", tmp_path / "copy" / "graph.g2o")
    with pytest.raises(DataError, match="copy"):
        mqslam.merge([days["monday"], tmp_path / "copy"], tmp_path / "out")


def test_a_folder_that_is_no_result_is_refused(days: Days, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="does not exist"):
        mqslam.merge([days["monday"], tmp_path / "nothing"], tmp_path / "out")
    with pytest.raises(DataError, match="holds no keyframes; give the folder of a result"):
        mqslam.merge([days["monday"], tmp_path], tmp_path.parent / "out")
