"""Judges the map that a recording makes under a trajectory, or a finished cloud, without ground truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from mqslam.auditing import judge
from mqslam.auditing.gyroscope_check import GyroscopeCheck, check_gyroscope, judge_gyroscope
from mqslam.auditing.mending.rounds import AuditedTrajectory, Mended
from mqslam.auditing.mending.rounds import mend as mend_trajectory
from mqslam.auditing.odometry_check import check_odometry
from mqslam.auditing.own_test import load_test
from mqslam.auditing.revisits import judge_honesty
from mqslam.auditing.sources import (
    Source,
    divide_cloud,
    fit_covariances,
    is_cloud,
    make_lidar_source,
    move_cloud,
    place_source,
    read_stated_covariances,
)
from mqslam.auditing.sweeps import Sweeps, require_covered
from mqslam.auditing.table import MapTest
from mqslam.auditing.verdict import Finding
from mqslam.backend.marginals import RelativeCovariances
from mqslam.backend.sensors.odometry import ODOMETRY
from mqslam.commands.inputs import WHOLE, Span, carry_to_radar, check_arguments, open_radar_or_lidar, read_extrinsics
from mqslam.commands.lidar_inputs import warn_of_idle
from mqslam.commands.lidar_settings import fit_to_rooms
from mqslam.commands.result import AuditResult, read_result
from mqslam.commands.work import QUIET, Work
from mqslam.config import Config, ConfigSource, load_config, set_doppler_beta, set_tolerance, set_values
from mqslam.core import se2
from mqslam.core.point_map import TimedCloud
from mqslam.core.recording import LidarRecording, Recording
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of, left_or_right
from mqslam.detection.stage import detect_all, make_scans, warn_of_unread
from mqslam.errors import ConfigError, DataError, Remedy, find_near, require_type, to_path, untrusted
from mqslam.execution.checkpoint import hash_run, keep_checkpoint
from mqslam.execution.folders import claim_folder, write_folder_aside
from mqslam.execution.runner import Runner
from mqslam.formats.clouds import read_cloud
from mqslam.formats.trajectories import read_with_notes
from mqslam.formats.tum import write_tum
from mqslam.psi.doppler import choose_doppler
from mqslam.psi.place import beam_of
from mqslam.report.audit_page import write_audit_page
from mqslam.results.audit_gate import list_worse
from mqslam.results.audit_results import summarise, summarise_mended, write_audit
from mqslam.results.files import add_warnings
from mqslam.results.run_results import summarise_check

_LONGEST_OFFSET_S = 1e11  # three thousand years: a larger offset is in another unit, or not a number
CARRIED = ("recording", ODOMETRY, "ground_truth")  # the names of trajectories that a recording may carry
_OWN = CARRIED[0]


def audit(  # noqa: PLR0913 - these are the options of an audit, each with its default
    data: Path | str,
    out: Path | str,
    *,
    trajectory: Trajectory | Path | str = _OWN,
    times: Path | str | None = None,
    topic: str | None = None,
    frame: str | None = None,
    time_offset_s: float = 0.0,
    extrinsics: Sequence[float] | str | None = None,
    heights: tuple[float, float] | None = None,
    covariances: Path | str | None = None,
    false_alarms: float | None = None,
    tolerance: float | None = None,
    test: Path | str | None = None,
    config: ConfigSource = None,
    format: str | None = None,
    range_resolution: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    mend: bool = False,
    baseline: Path | str | None = None,
    resume: bool = False,
    force: bool = False,
    work: Work = QUIET,
) -> AuditResult:
    """Judges the map that a recording makes under a trajectory, or a finished map, without ground truth.

    Args:
        data: a radar or lidar recording, or a cloud of points with times.
        out: folder for the results; it must not exist yet.
        trajectory: poses of the sensor, or the path of a file or of another SLAM system's result, or the name of a
            trajectory that the recording carries: `recording`, `odometry` or `ground_truth`.
        times: file with the stamps of a KITTI trajectory, one per line.
        topic: topic of the trajectory in a bag; None takes the only topic that holds poses or, if none does, the transforms.
            If several topics hold poses, one must be named.
        frame: frame whose pose is read from the transforms of a bag; None takes base_link, or the only frame that moves. If
            several frames move, one must be named.
        time_offset_s: time that is added to the stamps of the trajectory [s], if its clock differs from the data's.
        extrinsics: pose of the sensor in the frame whose trajectory is given, such as a vehicle's base: x [m] forward, y [m]
            to the left and yaw [degrees] to the left, or the three as a text X,Y,YAW; None if the trajectory is the
            sensor's own.
        heights: (lowest, highest) height of the points of a cloud that are used [m]; None takes all points.
        covariances: file with covariances of the trajectory's poses, by which revisits are tested: a run's covariances.csv,
            TUM with a covariance in each line, or a bag; None takes the covariances in the trajectory's own file, or
            covariances.csv beside a run's trajectory.tum.
        false_alarms: probability that an audit calls a good map bad, in (0, 0.5); None takes the settings' value.
        tolerance: how far two passes may be apart [m]; all other tolerances change in proportion. None takes the tolerances
            of the settings.
        test: Python file with a test of your own, which then also judges the map; None adds no test.
        config: a `Config`, a dict of the settings that differ, such as `{"detector": {"threshold": 60}}`, the path of a YAML
            file, or the name of a shipped configuration; None takes the defaults. With a lidar's recording or cloud, lengths
            that suit rooms take the place of defaults.
        format: layout of the recording, such as `oxford` or `rosbag`; None guesses it from the path.
        range_resolution: length of a range bin [m], if the recording states none or a wrong one.
        start_s: scans that begin before this time are left out [s since the recording's start]; None leaves out none.
        end_s: scans that begin at this time or later are left out [s since the recording's start]; None leaves out none.
        mend: whether to correct the trajectory by the findings, write the corrected trajectory as mended.tum, with the
            stamps and in the frame of the given one, and audit it too; the verdict is still on the given trajectory.
        baseline: folder of an earlier audit with which the verdict and the tests are compared; None compares with none.
        resume: whether an unfinished audit at `out` is continued, with the returns that it has detected in radar data.
        force: whether a result that exists at `out` is replaced.
        work: the engine that does the computations, and the functions that get progress and notes.

    Returns:
        The result that was written to `out`.

    Raises:
        MqslamError: the audit is impossible; at most an unfinished part stays at `out`, which `resume` continues.

    Example:
        >>> audited = mqslam.audit("drive", "audited", trajectory="theirs.tum")  # doctest: +SKIP
        >>> print(audited.verdict, audited.reasons)  # doctest: +SKIP
    """
    data, out = check_arguments(data, out, work)
    with claim_folder(out, force=force, resume=resume, sources=[data]), ExitStack() as keeping:
        earlier = None if baseline is None else _read_baseline(Path(baseline))
        _set_limits(Config(), false_alarms, tolerance)  # raises for a wrong rate or tolerance before anything is read
        own = [] if test is None else [load_test(Path(test))]
        of_cloud = is_cloud(data)
        if of_cloud and (start_s, end_s) != WHOLE:
            raise ConfigError(f"{data}: only a recording can be audited in part, not a cloud; leave out start and end")
        stated, mount = read_extrinsics(extrinsics)
        if mount is not None and covariances is not None:
            raise ConfigError(
                "covariances and extrinsics cannot be given together, because covariances are not converted to another "
                "frame; leave out the extrinsics if the trajectory is the sensor's own, else leave out the covariances"
            )
        given, understood = _read_given(
            trajectory, None if times is None else Path(times), topic, frame, time_offset_s, mount
        )
        of_poses, missing = (None, []) if mount is not None else read_stated_covariances(covariances, trajectory, given)
        name = "given" if isinstance(trajectory, Trajectory) else str(trajectory)
        if of_cloud and mend and given is None:
            raise ConfigError(f"{data}: a cloud without its trajectory cannot be mended", Remedy.GIVE_TRAJECTORY)
        if of_cloud:
            subject = _place_cloud(data, read_cloud(data, heights), given, config)
        else:
            settings = load_config(config)
            recording = _open(data, format, range_resolution, settings, given, (start_s, end_s), time_offset_s)
            if isinstance(recording, LidarRecording):
                settings, source, idle = fit_to_rooms(settings), make_lidar_source(recording), warn_of_idle(settings)
                subject = _place_recording(source, given or _pick_carried(data, source.tracks, name), settings, idle)
            else:
                keep = keep_checkpoint(out, hash_run(recording, settings, "audit", recording.odometry), resume=resume)
                runner = Runner(work.engine, work.progress, keeping.enter_context(keep))
                subject = _place_recording(*detect_radar(recording, given, name, settings, runner))
        sweeps, track, warnings = subject.sweeps, subject.track, subject.warnings
        notes = [*subject.notes, *understood]
        if mount is not None:
            notes.append(f"the given poses are converted to the sensor by the extrinsics: {_describe_mount(mount)}")
        if given is not None and sweeps.track is not None and not of_cloud:  # the points of a cloud are placed already
            sat = np.zeros(3) if mount is None else mount
            sweeps = replace(sweeps, track=replace(sweeps.track, extrinsics=sat, time_offset_s=time_offset_s))
        relative, unfit = fit_covariances(of_poses, round(1e6 * time_offset_s), sweeps)
        notes += [*missing, *unfit]
        for line in (*notes, *warnings):
            work.tell(line)
        subject = replace(subject, settings=_set_limits(subject.settings, false_alarms, tolerance))
        turning = subject.check_turns(sweeps)
        if turning is not None and turning.agrees is not False:
            work.tell(turning.statement)
        judged = subject.judge_map(sweeps, work, turning, relative, own)
        summary = {
            **summarise(
                judged,
                sweeps,
                subject.settings,
                {"format": subject.format, "path": str(data)},
                None if sweeps.track is None else name,
                warnings,
                stated,
                is_part=(start_s, end_s) != WHOLE,
            ),
            "notes": notes,
            "gyroscope": None if turning is None else summarise_check(turning),
            "covariances": _judge_honesty(judged, notes),
        }
        summary |= {
            "not_judged": summary["not_judged"] + _list_unknown_covariances(summary, relative),
            "baseline": earlier and _compare(summary, earlier, str(baseline), notes, work),
        }
        mended: Mended | None = None
        if mend and track is not None:
            audited = AuditedTrajectory(track, sweeps, judged)
            mended = mend_trajectory(
                audited,
                subject.place,
                lambda shown: subject.judge_map(shown, work, subject.check_turns(shown)),
                subject.settings,
                work.engine,
                work.progress,
            )
            summary["mended"] = summarise_mended(mended, summary, subject.settings, is_part=(start_s, end_s) != WHOLE)
        with write_folder_aside(out) as folder:
            write_audit(folder, subject.settings, summary, work.word)
            if mended is not None:
                write_tum(folder / "mended.tum", _convert_back(mended.result.trajectory, time_offset_s, mount))
            after = None if mended is None else mended.result
            failures = write_audit_page(folder, data.resolve().name, judged, sweeps, subject.settings, summary, after)
            add_warnings(folder / "audit.json", summary, failures)
        for warning in summary["warnings"][len(warnings) :]:
            work.tell(warning)
        return AuditResult(out, summary)


def _read_baseline(folder: Path) -> dict[str, Any]:
    """Reads the content of audit.json of an earlier audit.

    Raises:
        DataError: the folder holds no result of an audit, or its findings are damaged.
    """
    result = read_result(folder)
    if not isinstance(result, AuditResult) or not {"verdict", "tests"} <= result.summary.keys():
        raise DataError(folder, "holds no result of an audit that can be a baseline", "give the folder of an earlier audit")
    with untrusted.blame_file(folder / "audit.json"):
        list_worse(result.summary, result.summary)  # raises for damaged findings before anything is judged
    return result.summary


def _open(
    data: Path,
    format: str | None,
    range_resolution: float | None,
    settings: Config,
    given: Trajectory | None,
    span: Span,
    time_offset_s: float,
) -> Recording:
    """Opens the recording to audit.

    Args:
        data: path of the recording.
        format: its layout; None guesses it from the path.
        range_resolution: length of a range bin [m]; None takes the value in the settings or the recording.
        settings: all settings.
        given: the trajectory to audit, with `time_offset_s` added to its stamps; None if the recording carries it.
        span: begin and end of the part that is audited [s since the recording's start].
        time_offset_s: the time that was added [s], for the error.

    Raises:
        MqslamError: the recording cannot be opened. If only a part is audited or an offset was added, also if `given` covers
            fewer than two scans.
    """
    recording = open_radar_or_lidar(data, format, range_resolution, settings, span=span)
    causes = ["only a stretch of the recording was asked for"] if span != WHOLE else []
    causes += [f"an offset of {time_offset_s:g} s was added to the trajectory's stamps"] if time_offset_s != 0.0 else []
    if given is not None and causes:
        scans = recording.scans if isinstance(recording, LidarRecording) else make_scans(recording)
        require_covered(scans, given, ", and ".join(causes))
    return recording


def _list_unknown_covariances(summary: dict[str, Any], stated: RelativeCovariances | None) -> list[str]:
    """Returns a line for the entry `not_judged` if covariances are stated, but no revisit shows whether they are right."""
    is_unknown = stated is not None and summary["covariances"] is None
    return ["the stated covariances: no revisit shows whether they are right"] if is_unknown else []


def _compare(
    summary: dict[str, Any], earlier: dict[str, Any], path: str, notes: list[str], work: Work
) -> dict[str, str | list[str]]:
    """Returns the entry `baseline` of audit.json, and adds a note to `notes` if the earlier audit is of other scans."""
    own, other = summary["dataset"], earlier.get("dataset") or {}
    if any(own[name] != other.get(name) for name in ("format", "sweeps")):
        was, now = (f"{count_of(one.get('sweeps', 0), 'scan')} ({one.get('format')})" for one in (other, own))
        notes.append(f"the baseline is an audit of {was}, not of these {now}: a change may come from the data alone")
        work.tell(notes[-1])
    return {"path": path, "worse": list_worse(summary, earlier)}


def _judge_honesty(judged: judge.Audit, notes: list[str]) -> dict[str, Any] | None:
    """Compares the covariances that a trajectory states with its errors at revisits, and adds the outcome to `notes`.

    Returns:
        The outcome as JSON values; None if the trajectory states no covariances, or if no revisit can test them.
    """
    honesty = judge_honesty(judged.revisits)
    if honesty is None:
        return None
    notes.append(honesty.statement)
    return asdict(honesty)


def _set_limits(settings: Config, false_alarms: float | None, tolerance: float | None) -> Config:
    """Returns settings with another rate of false alarms and another tolerance [m]; None keeps the value in the settings.

    Raises:
        ConfigError: the rate or the tolerance is out of its range.
    """
    if false_alarms is not None:
        require_type(false_alarms, Real, "false_alarms", "a number")
        if not 0.0 < false_alarms < 0.5:
            raise ConfigError(f"a rate of false alarms of {false_alarms:g} is not between 0 and 0.5; give one such as 0.01")
        settings = set_values(settings, "verdict", false_alarms=false_alarms)
    return set_tolerance(settings, tolerance)


@dataclass(frozen=True)
class _Subject:
    """The recording or cloud that is audited, under a trajectory.

    Args:
        sweeps: the points, placed by the trajectory and divided into sweeps; a sweep of a recording is a scan.
        track: the trajectory of the sensor; None for a cloud that comes without a trajectory.
        settings: all settings, with the Doppler shift that was used; `audit` later sets the rate of false alarms and the
            tolerance.
        format: name of the layout of the recording or cloud.
        notes: sentences for the user on how the recording or cloud was read.
        place: returns the points, placed by another trajectory with the same stamps.
        warnings: faults of the recording, in sentences.
        source: the recording; None for a cloud.
    """

    sweeps: Sweeps
    track: Trajectory | None
    settings: Config
    format: str
    notes: Sequence[str]
    place: Callable[[Trajectory], Sweeps]
    warnings: Sequence[str] = ()
    source: Source | None = None

    def judge_map(
        self,
        shown: Sweeps,
        work: Work,
        turning: GyroscopeCheck | None,
        stated: RelativeCovariances | None = None,
        own: Sequence[MapTest] = (),
    ) -> judge.Audit:
        """Judges the map that the recording or cloud makes under a trajectory.

        Args:
            shown: the points, placed by the trajectory that is judged.
            work: the engine that does the computations, and the functions that get progress and notes.
            turning: comparison of the gyroscope with the trajectory; None without a gyroscope.
            stated: covariances that the trajectory itself states; None if it states no covariances.
            own: tests that the user has added.
        """
        sensors = [*([] if turning is None else [judge_gyroscope(turning)]), *self.check_odometry(shown)]
        odometry, place = self._find_odometry(), None if self.track is None else self.place_poses
        driven = None if odometry is None or self.track is None else odometry.at(self.track.stamps_us)
        known = judge.Known(stated, place, sensors, own, odometry=driven)
        return judge.audit(shown, self.settings, work.engine, work.progress, known=known)

    def place_poses(self, poses: se2.Array) -> Sweeps:
        """Returns the points, placed by poses (M, 3) [m, m, rad] at the stamps of `track`, which must not be None."""
        assert self.track is not None
        return self.place(Trajectory(self.track.stamps_us, poses))

    def check_turns(self, shown: Sweeps) -> GyroscopeCheck | None:
        """Compares the recording's gyroscope with the trajectory that placed `shown`; returns None if either is missing."""
        trajectory = self._find_shown(shown)
        if self.source is None or self.source.gyroscope is None or trajectory is None:
            return None
        return check_gyroscope(self.source.gyroscope, self.source.scans, trajectory)

    def check_odometry(self, shown: Sweeps) -> list[Finding]:
        """Returns findings on how the recording's odometry compares with the trajectory that placed `shown`.

        The list is empty if there is no odometry, if the odometry itself is audited, or if the points have no trajectory.
        """
        trajectory, odometry = self._find_shown(shown), self._find_odometry()
        if self.source is None or odometry is None or trajectory is None:
            return []
        return check_odometry(odometry, self.source.scans, trajectory, self.settings.odometry)

    def _find_odometry(self) -> Trajectory | None:
        """Returns the recording's odometry; None if there is none, or if the odometry itself is audited."""
        odometry, track = None if self.source is None else self.source.tracks.get(ODOMETRY), self.track
        if odometry is None or track is None:
            return None
        is_own = np.array_equal(odometry.stamps_us, track.stamps_us) and np.array_equal(odometry.poses, track.poses)
        return None if is_own else odometry

    def _find_shown(self, shown: Sweeps) -> Trajectory | None:
        """Returns the trajectory that placed the points `shown`; None if they have no trajectory."""
        if self.track is None or shown.track is None:
            return None
        return Trajectory(self.track.stamps_us, shown.track.poses)


def _place_cloud(data: Path, cloud: TimedCloud, given: Trajectory | None, config: ConfigSource) -> _Subject:
    """Makes the subject of an audit from a cloud, which is divided into sweeps; a lidar's cloud gets settings for rooms.

    Args:
        data: the cloud's file.
        cloud: the points.
        given: the trajectory that the cloud was made with; None if it is unknown.
        config: settings as `load_config` takes them.
    """
    settings = load_config(config)
    settings = settings if cloud.is_of_radar else fit_to_rooms(settings)
    beam = beam_of(settings.estimator, 0.0)

    def move(mended: Trajectory) -> Sweeps:
        return divide_cloud(cloud if given is None else move_cloud(cloud, given, mended), mended, beam)

    sweeps = divide_cloud(cloud, given, beam)
    return _Subject(sweeps, given, settings, data.suffix.lower()[1:], cloud.notes, move)


def _place_recording(source: Source, track: Trajectory, settings: Config, faults: Sequence[str] = ()) -> _Subject:
    """Makes the subject of an audit from a recording, the trajectory that places its returns, and notes on its faults."""
    beam = beam_of(settings.estimator, settings.sensor.doppler_beta or 0.0)
    sweeps, placing = place_source(source, track, beam)
    notes, warnings = [*source.notes, *placing], list(faults)

    def move(mended: Trajectory) -> Sweeps:
        return place_source(source, mended, beam)[0]

    return _Subject(sweeps, track, settings, source.format, notes, move, warnings, source)


def _describe_mount(mount: se2.Array) -> str:
    """Describes the pose (3,) of a sensor on a vehicle [m, m, rad] in words."""
    x, y, yaw = mount
    ahead = f"{abs(x):g} m {'behind' if x < 0.0 else 'ahead'}"
    aside = f"{abs(y):g} m to the {left_or_right(y)}"
    return f"{ahead}, {aside}, turned by {abs(np.degrees(yaw)):g} deg to the {left_or_right(yaw)}"


def _read_given(
    trajectory: Trajectory | Path | str,
    times: Path | None,
    topic: str | None,
    frame: str | None,
    time_offset_s: float,
    mount: se2.Array | None,
) -> tuple[Trajectory | None, list[str]]:
    """Returns the sensor's trajectory as it is given or read from a file, with notes for the user on how the file was read.

    The trajectory is None if `trajectory` names one that the recording carries. The other arguments are those of `audit`,
    but `mount` holds the extrinsics as a pose (3,) [m, m, rad].

    Raises:
        ConfigError: stamps, a topic, a frame, an offset or extrinsics are given without a trajectory from a file, the
            trajectory holds no poses, or the offset is longer than 3000 years, and therefore not in seconds.
        DataError: the file is not a trajectory.
    """
    if isinstance(trajectory, str) and trajectory in CARRIED:
        if any(option is not None for option in (times, topic, frame, mount)) or time_offset_s != 0.0:
            problem = "times, topic, frame, offset and extrinsics can be given only together with a trajectory from a file"
            raise ConfigError(problem, Remedy.GIVE_TRAJECTORY)
        return None, []
    if isinstance(trajectory, str) and not Path(trajectory).exists() and (near := find_near(trajectory, CARRIED)):
        raise DataError(trajectory, "does not exist", f"check the path, or did you mean {near}?")
    if isinstance(trajectory, Trajectory):
        given, notes = trajectory, list[str]()
        if not len(given):
            raise ConfigError("trajectory: holds no poses; give one with at least two")
    else:
        or_else = ", the name of a trajectory that the recording carries, or a mqslam.Trajectory"
        given, notes = read_with_notes(to_path(trajectory, "trajectory", or_else), times, topic, frame)
    require_type(time_offset_s, Real, "time_offset_s", "a number of seconds")
    if not abs(time_offset_s) <= _LONGEST_OFFSET_S:
        raise ConfigError(
            f"a time offset of {time_offset_s:g} s is no possible offset of a clock; give the offset in seconds"
        )
    poses = given.poses if mount is None else se2.compose(given.poses, mount)
    return Trajectory(given.stamps_us + round(1e6 * time_offset_s), poses), notes


def _convert_back(trajectory: Trajectory, time_offset_s: float, mount: se2.Array | None) -> Trajectory:
    """Converts the sensor's trajectory to the clock and the frame of the user's trajectory: the inverse of `_read_given`."""
    poses = trajectory.poses if mount is None else se2.compose(trajectory.poses, se2.inverse(mount))
    return Trajectory(trajectory.stamps_us - round(1e6 * time_offset_s), poses)


def _pick_carried(path: Path, tracks: dict[str, Trajectory], name: str) -> Trajectory:
    """Returns the trajectory of a given name among those that a recording carries.

    Raises:
        ConfigError: the recording carries no trajectory of that name.
    """
    if name not in tracks:
        has = f"it carries {', '.join(tracks)}" if tracks else "it carries none"
        remedy = Remedy.GIVE_TRAJECTORY_OR_NAME if tracks else Remedy.GIVE_TRAJECTORY
        lacks = "no trajectory of its own" if name == _OWN else f"no trajectory '{name}'"
        raise ConfigError(f"{path}: has {lacks} ({has})", remedy)
    return tracks[name]


def detect_radar(
    recording: Recording,
    given: Trajectory | None,
    name: str,
    settings: Config,
    runner: Runner,
) -> tuple[Source, Trajectory, Config, list[str]]:
    """Detects the returns of a radar recording, and chooses the trajectory and the Doppler shift to audit it with.

    Args:
        recording: the recording.
        given: trajectory of the sensor; None takes the trajectory `name` that the recording carries.
        name: `odometry` or `ground_truth`; it has no effect if a trajectory is given.
        settings: all settings.
        runner: detects the returns, keeps them for a resumed audit, and reports the progress.

    Returns:
        The recording with its scans, the trajectory, the settings with the Doppler shift, and the faults of the recording.

    Raises:
        MqslamError: most scans cannot be read, the recording carries no trajectory of that name, or the trajectory covers
            fewer than two scans.
    """
    odometry = carry_to_radar(recording.odometry, recording.mount)
    carried = {ODOMETRY: odometry, "ground_truth": recording.ground_truth}
    tracks = {name: track for name, track in carried.items() if track is not None}
    track = given or _pick_carried(recording.path, tracks, name)
    require_covered(make_scans(recording), track)  # raises before the recording is read if the trajectory does not fit
    scans, detected = detect_all(recording, settings.detector, runner)
    source = Source(recording.format, scans, tracks, recording.notes, recording.gyroscope)
    beta = choose_doppler(scans, settings, runner.engine).beta
    return source, track, set_doppler_beta(settings, beta), [*recording.faults, *warn_of_unread(detected.unread)]
