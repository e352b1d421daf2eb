from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from support.drives import street_drive

from mqslam.config import Config, Open3dIcpConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.errors import ConfigError
from mqslam.frontends.open3d_icp import Open3dIcpFrontEnd


def context(config: Config) -> Context:
    recording, _ = street_drive()
    return Context(config, recording.revolution_s, recording.start_us, None)


def test_generalized_icp_stays_in_the_plane() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    recording, scans = street_drive()
    config = Config(open3d_icp=Open3dIcpConfig(method="generalized"))
    poses = np.array([motion.pose for motion in Open3dIcpFrontEnd(context(config)).measure(scans[:12])])
    truth = recording.drive.poses(np.array([scan.t0 for scan in scans[:12]]))
    off = se2.between(se2.between(truth[:-1], truth[1:]), poses)
    np.testing.assert_array_less(np.sqrt(np.mean(off**2, axis=0)), [0.15, 0.08, 0.01])


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (None, r"Open3D is not installed; install it with: .*\[open3d\]"),
        ("raise ImportError('libusb-1.0.so.0: cannot open shared object file')\n", r".*libusb-1\.0-0"),
    ],
    ids=["not installed", "without its system library"],
)
def test_where_open3d_cannot_be_imported_the_error_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str | None, message: str
) -> None:
    if module is None:
        monkeypatch.setitem(sys.modules, "open3d", None)
    else:
        (tmp_path / "open3d.py").write_text(module)
        monkeypatch.delitem(sys.modules, "open3d", raising=False)
        monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ConfigError, match=f"open3d_icp: {message}"):
        Open3dIcpFrontEnd(context(Config()))
