"""Fixtures shared by the tests: small recordings and the real sample where it is at hand."""

# ruff: noqa: E402 (NumPy reads the environment when it is loaded)
from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # several processes run tests: threads of each would only wait for one another

settings.register_profile(
    "repeatable", derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")  # what passes once passes again, however busy the machine is

from support.clusters import Cluster, cluster
from support.recordings import write_oxford

from mqslam.detection import stage as detection
from mqslam.report import canvas
from mqslam.simulator import SensorModel, simulate

REPORTS = Path(__file__).parent / "report"


@pytest.fixture(scope="module", autouse=True)
def coarse_figures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Lets reports draw small pictures, which makes a short run a fifth shorter; tests of the reports draw large ones."""
    with pytest.MonkeyPatch.context() as patch:
        if not request.path.is_relative_to(REPORTS):
            patch.setattr(canvas, "DPI", 40)
        yield


@pytest.fixture
def oxford(tmp_path: Path) -> Path:
    """A small recording in the Oxford layout."""
    return write_oxford(tmp_path / "drive")


@pytest.fixture
def crew(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cluster]:
    """A scheduler and two workers; stretches are so short that both have work for a while, and waits are short."""
    monkeypatch.setattr(detection, "_CHUNK", 4)
    monkeypatch.setattr("mqslam.execution.cluster._LOOK_S", 1.0)
    with cluster(tmp_path_factory.mktemp("crew") / "dask") as running:
        yield running


@pytest.fixture(scope="session")
def oxford_tiny() -> Path:
    """The eleven real polar scans, which the project does not ship."""
    folder = Path(__file__).parents[2] / "shared" / "data" / "oxford_tiny"
    if not folder.is_dir():
        pytest.skip(f"the real sample is not at {folder}")
    return folder


@pytest.fixture(scope="session")
def boreas_rt() -> Path:
    """One real polar scan whose chirps go up and down in turn, which the project does not ship."""
    folder = Path(__file__).parents[2] / "shared" / "data" / "boreas_rt"
    if not folder.is_dir():
        pytest.skip(f"the real polar scan is not at {folder}")
    return folder


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve simulated seconds of a street, with wheel odometry that slips and ground truth; nobody may change it."""
    out = tmp_path_factory.mktemp("street") / "drive"
    simulate(out, scene="street", duration_s=12.0, movers=3, seed=1)
    return out


@pytest.fixture(scope="module")
def lap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coarse recording of a bit more than one round of a block, with loops to be found, and settings that suit it."""
    folder = tmp_path_factory.mktemp("lap")
    simulate(
        folder / "drive",
        duration_s=52.0,
        sensor=SensorModel(turn_rate_hz=2.0, azimuths=200, range_resolution=0.35, max_range=80.0),
        movers=0,
    )
    (folder / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    return folder
