"""What is shown of a run is what the run has written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.keyframe_maps import two_recordings

from mqslam.errors import DataError
from mqslam.formats.maps.keyframe_folder import write_keyframes
from mqslam.viewer.scene import colour_between, colour_over_span, read_scene


def test_a_scene_holds_points_with_their_values_poses_and_loops(finished: Path) -> None:
    scene = read_scene(finished)
    assert scene.name == "result" and scene.points.shape == (16, 2)
    assert scene.points[5] == pytest.approx([21.0, -10.5])
    assert {name: values[0] for name, values in scene.values.items()} == {"psi": 2.0, "intensity": 40.0, "time": 0.0}
    assert scene.start_times.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert scene.trajectory.poses[2, :2].tolist() == [10.0, 10.0]
    assert scene.loops.tolist() == [[4, 0]]  # and none of the edges between successive scans


def test_a_folder_without_a_map_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"holds no map\.ply and no keyframes; give the folder of a finished run"):
        read_scene(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (
            "map.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "is damaged or of another kind",
        ),
        ("map.ply", "no map", "is damaged or of another kind"),
        ("graph.g2o", "EDGE_SE2 0 one", "is damaged or of another kind"),
        ("graph.g2o", "EDGE_SE2 0 5 1 0 0 1 0 0 1 0 1", "does not fit the 5 poses"),
        ("trajectory.tum", "1 2 3", "line 1 is not"),
    ],
)
def test_a_damaged_file_is_named(finished: Path, name: str, content: str, said: str) -> None:
    (finished / name).write_text(content)
    with pytest.raises(DataError, match=said) as refused:
        read_scene(finished)
    assert refused.value.path.name == name


def test_colours_grow_brighter_with_the_value_and_stand_out_from_the_ground() -> None:
    brightness = colour_between(np.linspace(0.0, 1.0, 50), 0.0, 1.0) @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(brightness) > 0.0) and brightness[0] > 60.0


def test_a_few_extreme_values_do_not_take_the_colours_from_the_rest() -> None:
    values = np.append(np.linspace(0.0, 1.0, 999), 1e6)
    assert np.array_equal(colour_over_span(values)[500], colour_between(np.array([0.5]), 0.0, 1.0)[0])
    assert colour_over_span(np.empty(0)).shape == (0, 3)


def test_keyframes_alone_are_shown_without_psi_and_without_a_line_between_recordings(tmp_path: Path) -> None:
    made = two_recordings()
    write_keyframes(tmp_path / "keyframes", made)
    for folder in (tmp_path / "keyframes", tmp_path):
        scene = read_scene(folder)
        assert scene.points.shape == (12, 2) and set(scene.values) == {"intensity", "time"}
        assert np.all(np.diff(scene.values["time"]) >= 0.0)
        np.testing.assert_array_equal(scene.trajectory.poses, made.keyframes.poses)
        np.testing.assert_allclose(scene.start_times, [0.0, 1.0, 2.0, 3.25, 4.5])
        assert scene.starts.tolist() == [3] and len(scene.loops) == 0


def test_a_map_is_shown_rather_than_the_keyframes_beside_it(finished: Path) -> None:
    write_keyframes(finished / "keyframes", two_recordings())
    assert read_scene(finished).points.shape == (16, 2)


def test_damaged_keyframes_are_named(tmp_path: Path) -> None:
    write_keyframes(tmp_path / "keyframes", two_recordings())
    (tmp_path / "keyframes" / "points.npy").unlink()
    with pytest.raises(DataError, match=r"points\.npy"):
        read_scene(tmp_path)
