"""A trajectory mended by its audit lies nearer to the truth, which takes no part in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation
from support.drives import block_drive

from mqslam.auditing.judge import Audit, audit
from mqslam.auditing.mending.along import measure_along, weigh_ties
from mqslam.auditing.mending.evidence import allow_for_turns, tie_spans
from mqslam.auditing.mending.rounds import AuditedTrajectory, Mended, carry, mend
from mqslam.auditing.registration import Registration
from mqslam.auditing.spans.torn import SpanAudit
from mqslam.auditing.sweeps import Sweeps, place_sweeps
from mqslam.auditing.verdict import Verdict, VerdictStatus
from mqslam.auditing.windows.windows import share_torn
from mqslam.config import Config
from mqslam.core import se2
from mqslam.core.measurement import Loop, Measurement
from mqslam.core.trajectory import Trajectory
from mqslam.execution.local_engine import LocalEngine
from mqslam.execution.progress import ignore_progress
from mqslam.execution.runner import Runner
from mqslam.psi.place import beam_of

CONFIG = Config()
BEAM = beam_of(CONFIG.estimator, 0.0)
Distort = Callable[[se2.Array], se2.Array]


def place(trajectory: Trajectory) -> Sweeps:
    return place_sweeps(block_drive()[1], trajectory, BEAM)[0]


def judge(sweeps: Sweeps, jobs: int = 2) -> Audit:
    return audit(sweeps, CONFIG, LocalEngine(jobs), ignore_progress)


def distorted(distort: Distort) -> AuditedTrajectory:
    """Returns the lap under its true trajectory made wrong, and its audit."""
    truth = block_drive()[0].ground_truth
    trajectory = Trajectory(truth.stamps_us, distort(truth.poses))
    sweeps = place(trajectory)
    return AuditedTrajectory(trajectory, sweeps, judge(sweeps))


def absolute_error(trajectory: Trajectory) -> float:
    """Returns the root mean square error [m] against the truth, best laid on it, as evo has it."""
    tracks = []
    for track in (block_drive()[0].ground_truth, trajectory):
        x, y, yaw = track.poses.T
        quaternions = Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True)
        tracks.append(PoseTrajectory3D(np.column_stack([x, y, 0.0 * x]), quaternions, track.stamps_us * 1e-6))
    tracks[1].align(tracks[0])
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((tracks[0], tracks[1]))
    return float(error.get_statistic(metrics.StatisticsType.rmse))


def jump(poses: se2.Array) -> se2.Array:
    """Moves all that comes after the middle by 0.6 m."""
    return poses + np.where(np.arange(len(poses)) > len(poses) // 2, 1.0, 0.0)[:, None] * [0.48, 0.36, 0.0]


def stretch(poses: se2.Array) -> se2.Array:
    """Makes all distances 0.3 % longer."""
    return poses * [1.003, 1.003, 1.0]


def turn(poses: se2.Array) -> se2.Array:
    """Lets the yaw drift by 0.2 degrees in 100 m."""
    steps = se2.between(poses[:-1], poses[1:])
    steps[:, 2] += np.hypot(*steps[:, :2].T) * np.radians(0.2) / 100.0
    return se2.chain(steps, poses[0])


def drift_apart(poses: se2.Array) -> se2.Array:
    """Moves the second pass by 3 m, slowly enough to bend no window."""
    along = np.linspace(0.0, 1.0, len(poses))
    return poses + np.clip(4.0 * along - 1.0, 0.0, 1.0)[:, None] * [0.0, 3.0, 0.0]


def tear(poses: se2.Array) -> se2.Array:
    """Moves all that comes after the middle by 2 m within 20 m of path."""
    along = (se2.path_lengths(poses) - 0.5 * se2.path_lengths(poses)[-1]) / 20.0
    return poses + np.clip(along, 0.0, 1.0)[:, None] * [1.6, 1.2, 0.0]


def turn_at_random(poses: se2.Array) -> se2.Array:
    """Turns every seventh step by two or three degrees, as wheels that slip do, which bends one window after the other."""
    steps = se2.between(poses[:-1], poses[1:])
    slips = np.arange(3, len(steps), 7)
    steps[slips, 2] += np.random.default_rng(1).choice([-1.0, 1.0], len(slips)) * np.linspace(0.035, 0.05, len(slips))
    return se2.chain(steps, poses[0])


def mended(given: AuditedTrajectory, jobs: int = 2) -> Mended:
    return mend(given, place, lambda sweeps: judge(sweeps, jobs), CONFIG, LocalEngine(jobs), ignore_progress)


@pytest.mark.parametrize(
    ("distort", "share"),
    [(jump, 0.1), (stretch, 0.3), (turn, 0.1), (drift_apart, 0.3)],
    ids=lambda v: getattr(v, "__name__", ""),
)
def test_what_an_audit_finds_is_mended(distort: Distort, share: float) -> None:
    given = distorted(distort)
    assert given.audit.verdict.status in (VerdictStatus.WARN, VerdictStatus.FAIL)
    result = mended(given)
    assert result.result.audit.verdict.status in (VerdictStatus.PASS, VerdictStatus.WARN) and not result.is_worse
    assert absolute_error(result.result.trajectory) < share * absolute_error(given.trajectory)
    assert result.result.trajectory.stamps_us.tolist() == given.trajectory.stamps_us.tolist()
    assert result.result.trajectory.poses[0] == pytest.approx(given.trajectory.poses[0], abs=2e-3)


@pytest.mark.parametrize(("jump_at", "ties"), [(9, 1), (10, 0), (15, 0), (21, 0), (22, 1)])
def test_a_span_whose_scans_lie_on_both_sides_of_a_jump_ties_nothing(jump_at: int, ties: int) -> None:
    """The scans at its ends are those around the sweeps 10 and 20."""
    sweeps = place(block_drive()[0].ground_truth)
    sure = 1e-4 * np.eye(3)
    registration = Registration(
        10, 20, np.array([30.0, 0.0, 0.0]), 30.0, np.zeros(3), sure, np.zeros(2), 30.0, 0.8, 1.0, 1.0, True, True
    )
    span = SpanAudit(registration, 2.5, 5.0, np.zeros(3), sure, 0.5, torn=False)
    assert len(tie_spans([span], sweeps, {jump_at})) == ties


@pytest.mark.slow
def test_steps_that_are_turned_among_others_that_are_right_are_mended() -> None:
    given = distorted(turn_at_random)
    assert given.audit.verdict.status is VerdictStatus.FAIL
    result = mended(given)
    assert absolute_error(result.result.trajectory) < 0.05 * absolute_error(given.trajectory)
    assert share_torn(result.result.audit.windows).count < 0.1 * share_torn(given.audit.windows).count


def test_odometry_may_be_off_by_as_much_as_the_scans_turn_it_and_its_end_to_the_side() -> None:
    steps = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 0.0, 0.3]])
    wider = allow_for_turns(np.full((3, 3), 1e-4), steps, [1], np.array([[0.0, 0.0, 0.1]]))
    np.testing.assert_allclose(wider[[0, 2]], 1e-4)
    np.testing.assert_allclose(wider[1], [1e-4 + 0.04, 1e-4 + 0.04, 1e-4 + 0.01])


def test_a_trajectory_that_passes_is_left_as_it_is() -> None:
    given = distorted(lambda poses: poses)
    result = mended(given)
    assert given.audit.verdict.status is VerdictStatus.PASS
    assert result.result is given and result.rounds == 0 and not result.is_worse


def test_the_result_does_not_depend_on_the_number_of_workers() -> None:
    given = distorted(turn)
    one, three = (mended(given, jobs).result.trajectory.poses for jobs in (1, 3))
    assert one.tobytes() == three.tobytes()


def test_a_worse_trajectory_is_said_to_be_worse() -> None:
    given = distorted(stretch)

    def judge_badly(sweeps: Sweeps) -> Audit:
        return replace(judge(sweeps), verdict=Verdict(VerdictStatus.FAIL, "worse", ["worse"]))

    result = mend(given, place, judge_badly, CONFIG, LocalEngine(2), ignore_progress)
    assert given.audit.verdict.status is VerdictStatus.WARN and result.is_worse


def test_poses_between_scans_move_with_the_scans_beside_them() -> None:
    given = distorted(lambda poses: poses)
    times = given.sweeps.times
    track = given.trajectory
    dense = np.arange(track.stamps_us[0] - 300_000, track.stamps_us[-1] + 300_000, 50_000)
    fine = Trajectory(dense, track.at(dense))
    rigid = np.array([30.0, -20.0, 0.7])
    sweeps = place(fine)
    moved = carry(fine, sweeps, se2.compose(rigid, sweeps.poses))
    assert moved.poses == pytest.approx(se2.compose(rigid, fine.poses), abs=1e-9)
    half = len(times) // 2
    stepped = sweeps.poses + np.where(np.arange(len(times)) >= half, 1.0, 0.0)[:, None] * [0.6, 0.0, 0.0]
    shift = carry(fine, sweeps, stepped).poses[:, 0] - fine.poses[:, 0]
    seconds = fine.seconds(block_drive()[1].start_us)
    before, after = seconds <= times[half - 1], seconds >= times[half]
    assert shift[before] == pytest.approx(0.0, abs=1e-9) and shift[after] == pytest.approx(0.6, abs=1e-9)
    between = ~before & ~after
    assert between.any() and np.all((shift[between] > 0.0) & (shift[between] < 0.6))


def test_ties_along_the_path_show_a_scan_that_was_turned_wrongly() -> None:
    """All that comes after one step is turned by a degree; ties across that step say so, and others do not."""
    recording, scans = block_drive()
    truth = recording.ground_truth.at(scans.stamps_us)
    steps, kink = se2.between(truth[:-1], truth[1:]), len(truth) // 3
    steps[kink, 2] += np.radians(1.0)
    kinked = se2.chain(steps, truth[0])
    ties = measure_along(scans, Trajectory(scans.stamps_us, kinked), CONFIG, BEAM, Runner(LocalEngine(2)))
    earlier, later = (np.array([getattr(tie, end) for tie in ties]) for end in ("earlier", "later"))
    yaws = np.array([tie.pose[2] for tie in ties])
    wrong = np.degrees(se2.wrap(yaws - se2.between(kinked[earlier], kinked[later])[:, 2]))
    right = np.degrees(se2.wrap(yaws - se2.between(truth[earlier], truth[later])[:, 2]))
    across = (earlier <= kink) & (later > kink)
    assert across.sum() > 3 and np.median(np.abs(right)) < 0.1
    assert np.median(wrong[across]) == pytest.approx(-1.0, abs=0.1)
    assert abs(np.median(wrong[~across])) < 0.05
    sigmas = np.degrees(np.sqrt([tie.covariance[2, 2] for tie in ties]))
    assert np.median(np.square(right / sigmas)) < 1.0  # 0.455 if they err as they say


def test_ties_along_the_path_are_as_uncertain_as_the_motions_between_their_ends() -> None:
    """However sure ties say they are, they are as uncertain as drawn motions add up to."""
    rng = np.random.default_rng(7)
    spread = np.diag([0.02, 0.01, 0.003])
    motions = [Measurement(k, k + 1.0, np.array([2.0, 0.1, 0.05]), spread**2) for k in range(20)]
    tie, whole = weigh_ties([Loop(4, 16, np.zeros(3), 1e-9 * np.eye(3), np.nan, np.nan)] * 2, motions)
    assert (tie.earlier, tie.later) == (4, 16) and np.array_equal(tie.covariance, whole.covariance)
    right = se2.chain(m.pose for m in motions[4:16])[-1]
    ends = [se2.chain(m.pose + spread @ rng.normal(size=3) for m in motions[4:16])[-1] for _ in range(4000)]
    drawn = np.cov(np.transpose(ends - right))
    scale = np.sqrt(np.diag(drawn))
    assert tie.covariance / np.outer(scale, scale) == pytest.approx(drawn / np.outer(scale, scale), abs=0.08)
    assert weigh_ties([], motions) == []
