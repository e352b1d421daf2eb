"""What `import mqslam` offers: documented names, found without heavy imports, silent, and to the command's own bytes."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from support.commands import mqslam as command
from support.commands import run_in_this_process

import mqslam
from mqslam.commands.result import RunResult
from mqslam.config import SensorConfig
from mqslam.detection.stage import detect_all
from mqslam.simulator import SensorModel, simulate

SCANS = 10
SETTINGS = mqslam.Config(sensor=SensorConfig(doppler_beta=0.0))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few coarse scans of a street; nobody may change them."""
    out = tmp_path_factory.mktemp("api") / "drive"
    sensor = SensorModel(azimuths=120, range_resolution=0.175, max_range=60.0)
    simulate(out, duration_s=SCANS / 4.0, sensor=sensor, movers=0)
    return out


@pytest.fixture(scope="module")
def result(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    """The results of a run of the drive."""
    return mqslam.run(drive, tmp_path_factory.mktemp("results") / "out", config=SETTINGS)


@pytest.mark.parametrize("name", sorted(set(mqslam.__all__) - {"__version__"}))
def test_every_public_name_resolves_and_is_documented(name: str) -> None:
    value = getattr(mqslam, name)
    assert name in dir(mqslam) and name in (mqslam.__doc__ or "")
    if not inspect.ismodule(value):
        assert len((inspect.getdoc(value) or "").split()) > 3


def test_the_covariances_of_a_run_are_read_with_their_stamps(result: RunResult) -> None:
    covariances, track = result.read_covariances(), result.read_trajectory()
    assert covariances.covariances.shape == (len(track.stamps_us), 3, 3)
    assert covariances.stamps_us.tolist() == track.stamps_us.tolist()


def test_scans_that_another_program_has_made_are_measured_and_a_list_is_refused(drive: Path) -> None:
    found, _ = detect_all(mqslam.open_recording(drive), SETTINGS.detector, mqslam.Runner())
    own = [mqslam.Scan(scan.t0, scan.t1, scan.returns) for scan in found]
    factors = mqslam.psi_factors(mqslam.Scans(tuple(own), found.start_us, found.revolution_s), config=SETTINGS)
    assert len(factors.scan_keys) == SCANS
    with pytest.raises(mqslam.MqslamError, match=r"mqslam\.Scans, not a list"):
        mqslam.psi_factors(own)


def test_inputs_and_results_in_memory_are_one_line_in_a_console(drive: Path, result: RunResult) -> None:
    recording = mqslam.open_recording(drive)
    track = result.read_trajectory()
    assert repr(recording) == f"<RowImageRecording '{drive}', oxford, 10 scans, 2.5 s>"
    scans, _ = detect_all(recording, SETTINGS.detector, mqslam.Runner())
    assert repr(scans).startswith("<Scans, 10 scans, 0.0 s to 2.") and repr(scans[:0]) == "<Scans, 0 scans>"
    assert repr(scans[0].returns) == f"<Returns, {len(scans[0].returns)} returns>"
    assert repr(track) == f"<Trajectory, 10 poses, 2.2 s, {track.length_m:.1f} m>"
    solved = mqslam.Slam(SETTINGS, "odometry").run(recording, recording.odometry)
    others = (
        scans[0],
        scans.scans,
        recording[0],
        recording.odometry,
        recording.gyroscope,
        result.read_covariances(),
        solved,
    )
    for thing in others:
        assert "\n" not in repr(thing) and len(repr(thing)) < 120 and "array" not in repr(thing)


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(AttributeError, match="module 'mqslam' has no attribute 'rnu'"):
        mqslam.rnu  # noqa: B018


def test_the_import_alone_loads_no_library() -> None:
    program = "import sys, mqslam; print(*[name for name in ('numpy', 'gtsam', 'pydantic') if name in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert shown.stdout.split() == []


def test_a_run_is_silent_and_returns_what_it_has_left(
    drive: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config = {"sensor": {"doppler_beta": 0.0}}
    result = mqslam.run(str(drive), str(tmp_path / "out"), frontend="odometry", config=config)
    assert mqslam.load_config(result.folder / "config.yaml") == SETTINGS
    assert capfd.readouterr() == ("", "")
    assert result.folder == tmp_path / "out" and result.report.is_file()
    assert result.verdict in ("pass", "warn", "fail", "not judged") and result.reasons
    assert len(result.read_trajectory()) == result.summary["dataset"]["revolutions"] == SCANS


def test_a_run_leaves_the_commands_bytes(drive: Path, result: RunResult, tmp_path: Path) -> None:
    (tmp_path / "quick.yaml").write_text("sensor: {doppler_beta: 0.0}\n")
    words = ("--config", tmp_path / "quick.yaml", "--jobs", 1, "--quiet")
    assert command("run", drive, "--out", tmp_path / "out", *words).code == 0
    for name in ("trajectory.tum", "measurements.csv", "covariances.csv"):
        assert (tmp_path / "out" / name).read_bytes() == (result.folder / name).read_bytes()


def test_notes_and_progress_go_to_who_asks_for_them(drive: Path, tmp_path: Path) -> None:
    stages: set[str] = set()
    work = mqslam.Work(progress=lambda stage, done, total: stages.add(stage))
    mqslam.run(drive, tmp_path / "out", frontend="odometry", config=SETTINGS, work=work)
    assert {"detect", "windows", "render"} <= stages


def test_the_method_runs_on_an_open_recording_with_defaults(drive: Path) -> None:
    run = mqslam.Slam().run(mqslam.open_recording(drive))
    assert len(run.optimised) == SCANS and len(run.measurements) == SCANS - 1


def test_an_audit_judges_a_given_trajectory(drive: Path, result: RunResult, tmp_path: Path) -> None:
    audited = mqslam.audit(drive, tmp_path / "audited", trajectory=result.read_trajectory(), config=SETTINGS)
    assert audited.report.is_file() and audited.summary["windows"]["count"] >= 1
    assert audited.verdict in ("pass", "warn", "fail", "not judged")


def test_a_comparison_has_a_row_per_front_end_and_trajectory(drive: Path, result: RunResult, tmp_path: Path) -> None:
    with run_in_this_process():
        compared = mqslam.compare(
            drive,
            tmp_path / "compared",
            frontends=["odometry"],
            trajectories={"mine": result.read_trajectory()},
            odometry_only=True,
            config=SETTINGS,
        )
    assert compared.report.is_file() and [row[0] for row in compared.table[1:]] == ["odometry", "mine"]
    assert compared.conclusion == compared.summary["best"]["sentence"] != ""
    assert {column for _, column in compared.marked} <= set(range(1, len(compared.table[0])))
