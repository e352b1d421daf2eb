"""What the front ends that match scans have in common: psi, KISS-ICP, Open3D and small_gicp."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from support.drives import find_errors, street_context, street_drive

from mqslam.config import Config, Open3dIcpConfig
from mqslam.core import frontend, se2
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import ConfigError, EstimationError

TWO_SCANS = {
    "psi": [0.06, 0.03, 0.005],
    "kiss_icp": [0.4, 0.2, 0.02],
    "open3d_icp": [0.4, 0.2, 0.02],
    "small_gicp": [0.4, 0.2, 0.02],
}

GENERALIZED = {"open3d_icp": Config(open3d_icp=Open3dIcpConfig(method="generalized")), "small_gicp": Config()}


@pytest.fixture(params=TWO_SCANS)
def name(request: pytest.FixtureRequest) -> str:
    if request.param in ("open3d_icp", "small_gicp"):
        pytest.importorskip(request.param.removesuffix("_icp"), exc_type=ImportError)
    return str(request.param)


def measure(name: str, scans: Sequence[Scan]) -> list[Measurement]:
    return list(frontend.load(name)(street_context()).measure(scans))


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_scans_hold_no_motion(name: str, count: int) -> None:
    with pytest.raises(EstimationError, match="at least two"):
        measure(name, street_drive()[1][:count])


def test_two_scans_are_enough(name: str) -> None:
    recording, scans = street_drive()
    np.testing.assert_array_less(np.abs(find_errors(recording, measure(name, scans[:2]))[0]), TWO_SCANS[name])


def test_the_same_scans_give_the_same_motions(name: str) -> None:
    scans = street_drive()[1][:15]
    for a, b in zip(measure(name, scans), measure(name, scans), strict=True):
        for field in ("pose", "covariance", "psi"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


@pytest.mark.parametrize("name", GENERALIZED, indirect=True)
def test_generalized_icp_stays_in_the_plane(name: str) -> None:
    recording, scans = street_drive()
    motions = frontend.load(name)(street_context(GENERALIZED[name])).measure(scans[:12])
    truth = recording.drive.poses(np.array([scan.t0 for scan in scans[:12]]))
    off = se2.between(se2.between(truth[:-1], truth[1:]), np.array([motion.pose for motion in motions]))
    np.testing.assert_array_less(np.sqrt(np.mean(off**2, axis=0)), [0.15, 0.08, 0.01])


@pytest.mark.parametrize(
    ("which", "module", "message"),
    [
        ("open3d_icp", None, r"Open3D is not installed; install it with: .*\[open3d\]"),
        ("open3d_icp", "raise ImportError('libusb-1.0.so.0: cannot open shared object file')\n", r".*libusb-1\.0-0"),
        ("small_gicp", None, r"small_gicp is not installed; install it with: .*\[small-gicp\]"),
    ],
    ids=["open3d is not installed", "open3d lacks its system library", "small_gicp is not installed"],
)
def test_where_a_package_cannot_be_imported_the_error_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, which: str, module: str | None, message: str
) -> None:
    package = which.removesuffix("_icp")
    if module is None:
        monkeypatch.setitem(sys.modules, package, None)
    else:
        (tmp_path / f"{package}.py").write_text(module)
        monkeypatch.delitem(sys.modules, package, raising=False)
        monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ConfigError, match=f"{which}: {message}"):
        frontend.load(which)(street_context())
