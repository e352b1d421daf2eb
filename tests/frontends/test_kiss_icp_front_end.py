from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.config import Config, KissIcpConfig, ScanMatchingConfig, dump_yaml, load_config
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.errors import ConfigError
from mqslam.frontends.kiss_icp import KissIcpFrontEnd


def front_end(own: Path | None, **settings: float) -> KissIcpFrontEnd:
    recording, _ = street_drive()
    config = Config(kiss_icp=KissIcpConfig(config_file=own), scan_matching=ScanMatchingConfig.model_validate(settings))
    return KissIcpFrontEnd(Context(config, recording.revolution_s, recording.start_us, None))


def poses(own: Path | None, count: int, **settings: float) -> se2.Array:
    return np.array([motion.pose for motion in front_end(own, **settings).measure(street_drive()[1][:count])])


def test_a_file_of_its_own_takes_the_place_of_our_settings(tmp_path: Path) -> None:
    path = tmp_path / "kiss.yaml"
    path.write_text("data: {max_range: 40.0, min_range: 0.0}\nmapping: {voxel_size: 2.0}\n", encoding="utf-8")
    by_file = poses(path, 4, voxel_size_m=0.7)
    np.testing.assert_array_equal(by_file, poses(None, 4, voxel_size_m=2.0, max_range_m=40.0))
    assert not np.array_equal(by_file, poses(None, 4))


def test_its_file_survives_the_settings_a_run_writes(tmp_path: Path) -> None:
    config = Config(kiss_icp=KissIcpConfig(config_file=tmp_path / "kiss.yaml"))
    (tmp_path / "config.yaml").write_text(dump_yaml(config), encoding="utf-8")
    assert load_config(tmp_path / "config.yaml") == config


FAULTS = {
    "no file": (None, "No such file"),
    "not YAML": ("mapping: [", "is not a YAML file"),
    "not settings": ("- 1\n- 2\n", "is not a YAML file"),
    "unknown section": ("maping: {voxel_size: 1.0}", "maping"),
    "unknown setting": ("mapping: {voxel: 1.0}", r"mapping\.voxel.*choose one of voxel_size"),
    "wrong type": ("data: {max_range: far}", r"data\.max_range"),
    "null for a number": ("registration: {max_num_iterations: null}", "is not a YAML file"),
    "no voxel": ("mapping: {voxel_size: 0.0}", r"mapping\.voxel_size: must be greater than 0"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_file_it_cannot_use_is_named_before_anything_is_read(tmp_path: Path, name: str) -> None:
    text, fault = FAULTS[name]
    path = tmp_path / "kiss.yaml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"kiss\.yaml: .*{fault}"):
        front_end(path)


def test_without_deskewing_a_pose_is_of_the_middle_of_its_scan(tmp_path: Path) -> None:
    own = tmp_path / "kiss.yaml"
    own.write_text("data: {max_range: 100.0, min_range: 0.0, deskew: false}\nmapping: {voxel_size: 1.0}\n", encoding="utf-8")
    recording, scans = street_drive()
    truth = recording.drive.poses(np.array([scan.t0 for scan in scans]))
    off = se2.between(se2.between(truth[:-1], truth[1:]), poses(own, len(scans)))
    np.testing.assert_array_less(np.sqrt(np.mean(off**2, axis=0)), [0.12, 0.05, 0.005])
