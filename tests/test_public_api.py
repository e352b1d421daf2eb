"""What `import mqslam` offers: documented names, found without heavy imports, silent, and to the command's own bytes."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.commands import mqslam as command
from support.commands import run_in_this_process
from support.rooms import PERIOD_US, STEP_M, write_carmen

import mqslam
from mqslam.commands.result import RunResult
from mqslam.config import SensorConfig
from mqslam.core.motion import CONSTANT_VELOCITY
from mqslam.detection.stage import detect_all
from mqslam.errors import ConfigError
from mqslam.psi.place import beam_of, place
from mqslam.psi.published import equations
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


def test_returns_are_those_of_a_run_and_psi_of_a_window_is_that_of_the_equations(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scans = mqslam.detect(drive)
    found, _ = detect_all(mqslam.open_recording(drive), SETTINGS.detector)
    np.testing.assert_array_equal(scans.scans.table, found.scans.table)
    assert len(mqslam.detect(drive, config={"detector": {"threshold": 90}})[0].returns) < len(scans[0].returns)
    score = mqslam.score(scans[4:7], (8.0, 0.05))
    returns = mqslam.Returns.concatenate([scan.returns for scan in scans[4:7]])
    points = place(
        returns, scans[4].t0, np.zeros(3), np.array([8.0, 0.05]), CONSTANT_VELOCITY, beam_of(SETTINGS.estimator, 0.0)
    )
    assert score.psi == equations.score(points.points, points.times, scans.revolution_s, SETTINGS.psi).psi > 0.0
    assert mqslam.score(scans[4:7], (8.0, 0.0, 0.05)).psi == score.psi and score.shares.shape == (len(returns),)
    assert f"psi={score.psi:g}" in repr(score) and "\n" not in repr(score)
    page = Path(__file__).parents[1] / "docs" / "reference" / "api.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    monkeypatch.chdir(drive.parent)
    exec(code, {})
    assert capsys.readouterr().out.splitlines()[-1] == str(score.psi)


def test_a_part_of_a_recording_is_opened_detected_and_measured(drive: Path, tmp_path: Path) -> None:
    span = {"start_s": 0.5, "end_s": 1.75}
    part, whole = mqslam.open_recording(drive, **span), mqslam.open_recording(drive)
    np.testing.assert_array_equal(part.stamps_us, whole.stamps_us[2:7])
    for source in (drive, whole):
        factors = mqslam.psi_factors(source, frontend="odometry", odometry=whole.odometry, config=SETTINGS, **span)
        for scans in (mqslam.detect(source, **span), factors.scans):
            np.testing.assert_array_equal(scans.stamps_us, part.stamps_us)
            np.testing.assert_array_equal(scans.scans.table, mqslam.detect(part).scans.table)
    with pytest.raises(ConfigError, match=r"only a recording is cut by start and end; cut .* as scans\[first:after\]"):
        mqslam.detect(factors.scans, start_s=0.5)
    write_carmen(tmp_path / "rooms.log")
    rooms = mqslam.open_recording(tmp_path / "rooms.log", start_s=1.0, end_s=3.0)
    np.testing.assert_array_equal(rooms.stamps_us, mqslam.open_recording(tmp_path / "rooms.log").stamps_us[5:15])
    assert mqslam.detect(tmp_path / "rooms.log", start_s=1.0, end_s=3.0).start_us == rooms.start_us


def test_psi_of_a_lidars_window_is_lowest_near_the_true_motion(tmp_path: Path) -> None:
    write_carmen(tmp_path / "rooms.log")
    scans = mqslam.detect(mqslam.open_recording(tmp_path / "rooms.log"))
    speed = STEP_M / (1e-6 * PERIOD_US)  # the robot drives straight ahead at first
    still, true, fast = (mqslam.score(scans[4:7], (v, 0.0)).psi for v in (0.0, speed, 2.0 * speed))
    assert true < 0.5 * min(still, fast)


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


LINE = mqslam.Trajectory(np.array([0, 250_000]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
NOWHERE = mqslam.Trajectory(LINE.stamps_us[:0], LINE.poses[:0])
WRONG_TYPES = {
    "run an open recording": (lambda drive, out: mqslam.run(mqslam.open_recording(drive), out), "data must be a path, as a"),
    "run a front end": (
        lambda drive, out: mqslam.run(drive, out, frontend=mqslam.Slam),
        "frontend must be a text: the name of a front end, .* but it is the class Slam",
    ),
    "run settings": (
        lambda drive, out: mqslam.run(drive, out, config=3),
        "config must be a Config, a dict of the .* but it is an object of type int",
    ),
    "run a section": (lambda drive, out: mqslam.run(drive, out, config={"detector": 3}), "detector"),
    "run a time": (lambda drive, out: mqslam.run(drive, out, start_s="1"), "start and end must be a number of seconds"),
    "run poses": (lambda drive, out: mqslam.run(drive, out, odometry=3), "odometry must be a path"),
    "run a mount": (lambda drive, out: mqslam.run(drive, out, extrinsics=3), "extrinsics 3: are not three numbers"),
    "run without odometry": (
        lambda drive, out: mqslam.run(drive, out, odometry=None),
        "odometry must be a path, as a text or a pathlib.Path, or one of the words auto and none",
    ),
    "run a tolerance": (lambda drive, out: mqslam.run(drive, out, tolerance="0.5"), "tolerance must be a number of metres"),
    "run bins": (lambda drive, out: mqslam.run(drive, out, range_resolution="0.04"), "range_resolution must be a number of"),
    "run bins in mm": (
        lambda drive, out: mqslam.run(drive, out, range_resolution=43),
        "cannot be the length of a range bin",
    ),
    "run jobs": (lambda drive, out: mqslam.run(drive, out, work=4), r"work must be a mqslam\.Work, such as .* type int"),
    "run an engine": (
        lambda drive, out: mqslam.run(drive, out, work=mqslam.LocalEngine(2)),
        r"work must be a mqslam\.Work, such as .* type LocalEngine",
    ),
    "work of jobs": (lambda drive, out: mqslam.Work(4), r"engine must be an engine, such as mqslam\.LocalEngine\(4\)"),
    "no processes": (lambda drive, out: mqslam.LocalEngine(0), "jobs must be at least 1"),
    "jobs in words": (lambda drive, out: mqslam.LocalEngine("4"), "jobs must be a whole number of processes"),
    "parts of jobs": (lambda drive, out: mqslam.LocalEngine(1.5), "jobs must be a whole number of processes"),
    "audit a rate": (lambda drive, out: mqslam.audit(drive, out, false_alarms="0.01"), "false_alarms must be a number"),
    "audit an offset": (
        lambda drive, out: mqslam.audit(drive, out, trajectory=LINE, time_offset_s="0.1"),
        "time_offset_s must be a number of seconds",
    ),
    "audit nothing": (lambda drive, out: mqslam.audit(drive, out, trajectory=NOWHERE), "trajectory: holds no poses"),
    "audit an array": (
        lambda drive, out: mqslam.audit(drive, out, trajectory=LINE.poses),
        r"trajectory must be a path, .* or a mqslam\.Trajectory, but it is an object of type ndarray",
    ),
    "audit an open recording": (
        lambda drive, out: mqslam.audit(mqslam.open_recording(drive), out),
        "data must be a path, .* mqslam.Slam and mqslam.psi_factors take open recordings",
    ),
    "compare settings": (
        lambda drive, out: mqslam.compare(drive, out, kiss_config="nope.yaml"),
        "nope.yaml: does not exist; give KISS-ICP's own YAML file",
    ),
    "factors of odometry": (lambda drive, out: mqslam.psi_factors(drive, odometry="none"), "odometry must be a mqslam.Traj"),
    "loops of poses": (
        lambda drive, out: mqslam.loop_factors(drive, LINE.poses),
        r"trajectory must be gtsam\.Values, or a mqslam\.Trajectory, such as .* type ndarray",
    ),
    "a slice of scans": (
        lambda drive, out: mqslam.open_recording(drive)[:4],
        r"take several from polar_scans\(start, stop\)",
    ),
    "slam with odometry": (
        lambda drive, out: mqslam.Slam().run(mqslam.open_recording(drive), "none"),
        "odometry must be a mqslam.Trajectory or None",
    ),
    "audit poses": (lambda drive, out: mqslam.audit(drive, out, trajectory=[1.0]), "trajectory must be a path"),
    "compare a front end": (
        lambda drive, out: mqslam.compare(drive, out, frontends=[mqslam.Slam]),
        "each of frontends must be the name of a front end",
    ),
    "compare a list": (
        lambda drive, out: mqslam.compare(drive, out, trajectories=["a.tum"]),
        "trajectories must be a dict of trajectories by the names of their rows",
    ),
    "localise a map": (lambda drive, out: mqslam.localise(drive, out, map=3), "map must be a path"),
    "merge a folder": (lambda drive, out: mqslam.merge(str(drive), out), "results must be a list of folders"),
    "merge runs": (lambda drive, out: mqslam.merge([3, 4], out), "each of results must be a path"),
    "open": (lambda drive, out: mqslam.open_recording(3), "a recording must be a path"),
    "read": (lambda drive, out: mqslam.read_result(None), "folder must be a path"),
    "psi of returns": (
        lambda drive, out: mqslam.score([], (1.0, 0.0)),
        r"scans must be mqslam\.Scans, such as .* type list",
    ),
    "psi of a scan": (
        lambda drive, out: mqslam.score(mqslam.Scans((), 0, 0.25), (1.0, 0.0)),
        "scans: 0 scans cannot be compared; give a window of two or more scans",
    ),
    "psi of no motion": (lambda drive, out: mqslam.score(mqslam.Scans((), 0, 0.25), "1,0"), "motion: is not a motion; give"),
    "scans of a list": (lambda drive, out: mqslam.detect([]), r"or mqslam\.Scans, not a list"),
    "slam of a path": (lambda drive, out: mqslam.Slam().run(str(drive)), "recording must be an open recording, as mqslam"),
    "slam with a name": (lambda drive, out: mqslam.Slam("oxford"), "config must be a Config, as mqslam.load_config"),
}


@pytest.mark.parametrize("name", WRONG_TYPES)
def test_an_argument_of_a_wrong_type_is_refused_by_name(name: str, drive: Path, tmp_path: Path) -> None:
    do, message = WRONG_TYPES[name]
    with pytest.raises(ConfigError, match=message):
        do(drive, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_returns_and_scans_of_a_wrong_shape_are_refused() -> None:
    row = np.zeros(3)
    for wrong in (row[:2], row[:, None], np.float64(1.0), [0.0, 0.0, 0.0]):
        with pytest.raises(ValueError, match=r"must be NumPy arrays \(N,\) of one length, and are \(3,\), \(3,\), "):
            mqslam.Returns(row, row, wrong, row)
    with pytest.raises(ValueError, match=r"must be mqslam\.Returns, and are an object of type list"):
        mqslam.Scan(0.0, 0.25, [row])
    for span in ((row, row), ("0", "1"), (1.0, 0.5), (np.nan, 0.25), (0.0, np.nan), (0.0, np.inf)):
        with pytest.raises(ValueError, match="give its start and its end in seconds"):
            mqslam.Scan(*span, mqslam.Returns.none())


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
    assert result.not_judged == result.summary["not_judged"] != []
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


def test_the_method_takes_a_dict_of_settings() -> None:
    mqslam.Slam({"detector": {"threshold": 60}})
    with pytest.raises(ConfigError, match="did you mean threshold"):
        mqslam.Slam({"detector": {"treshold": 60}})


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
