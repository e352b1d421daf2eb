"""The verdict on a run, and its warnings."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.reported import judged_window, swept_walls

from mqslam.auditing.findings import judge_windows
from mqslam.auditing.verdict import VerdictStatus, verdict_of
from mqslam.backend.range_scale import NOT_OF_RADAR, RangeScale
from mqslam.backend.sensor_use import SensorUse
from mqslam.backend.sensors.chirps import VelocityUse
from mqslam.backend.sensors.gnss import FixUse
from mqslam.backend.sensors.gyroscope import GyroscopeUse
from mqslam.backend.sensors.odometry import OdometryFault
from mqslam.config import Config
from mqslam.core.measurement import Measurement, Refined, Status
from mqslam.core.point_map import PointMap
from mqslam.core.trajectory import Trajectory
from mqslam.results.run_verdict import (
    _warn_of_gaps,
    _warn_of_stretches,
    find_stops,
    judge_run,
    list_unknowns,
    list_warnings,
    measure_ratio,
)

PASS, WARN, FAIL, NOT_JUDGED = VerdictStatus


@pytest.mark.parametrize(("standing_s", "said"), [(60.0, [(5.0, 65.25)]), (5.0, [])])
def test_a_long_stop_is_named_and_a_short_one_is_not(standing_s, said):
    driving = np.arange(0.0, 50.0, 2.5)
    stop = np.full(int(standing_s * 4.0), driving[-1]) + 0.01 * np.sin(np.arange(int(standing_s * 4.0)))
    x = np.concatenate([driving, stop, driving[-1] + 2.5 + driving])
    times = 0.25 * np.arange(len(x))
    run = SimpleNamespace(optimised=SimpleNamespace(poses=np.c_[x, np.zeros((len(x), 2))]), config=Config())
    recording = SimpleNamespace(start_times=times, duration_s=times[-1] + 0.25)
    found = find_stops(run, recording)
    assert len(found) == len(said)
    for span, expected in zip(found, said, strict=True):
        assert span == pytest.approx(expected, abs=0.6)


def pointmap(psi, matched=0.9, count=100):
    """Returns a map of so many points with a psi each."""
    zeros = np.zeros(count)
    return PointMap(np.zeros((count, 2)), zeros, zeros, np.full(count, psi), np.arange(count) < matched * count)


def driven(scans, step_m=1.0):
    """Returns a trajectory straight ahead."""
    return Trajectory(250_000 * np.arange(scans), np.c_[step_m * np.arange(scans), np.zeros((scans, 2))])


ASSUMED = SimpleNamespace(is_resolution_assumed=True, range_resolution=0.0438)


def run(scans, *, lost=0, degenerate=0, torn=0, before=0.5, after=0.4, **others):
    """Returns the parts of a run of so many scans that the verdict looks at."""
    statuses = [Status.LOST] * lost + [Status.DEGENERATE] * degenerate + [Status.CONVERGED] * (scans - 1 - lost - degenerate)
    sweeps = swept_walls()
    windows = [judged_window(sweeps, 0, 90.0, (0.2, 0.0, 0.0), k < torn) for k in range(scans // 6)]
    settings = Config()
    tests = {"windows": judge_windows(windows, scans)}
    return SimpleNamespace(
        frontend="psi",
        config=settings,
        measurements=[Measurement(k, k + 1, np.zeros(3), np.eye(3), status) for k, status in enumerate(statuses)],
        checks=windows,
        checked=SimpleNamespace(tests=tests),
        map_odometry=before if isinstance(before, PointMap) else pointmap(before),
        map_optimised=after if isinstance(after, PointMap) else pointmap(after),
        loops=[],
        **{
            "optimised": driven(scans),
            "odometry": driven(scans),
            "odometry_factors": 1,
            "sensors": SensorUse(),
            "refined": Refined([], []),
            "unoptimised": None,
            "unread": {},
            "range_scale": RangeScale(1.0, 0.01, 0.01, ()),
            **others,
        },
    )


@pytest.mark.parametrize(
    ("found", "status", "reason"),
    [
        (run(240), PASS, "0 of 40 windows are torn"),
        (run(240, torn=20), FAIL, "20 of 40 windows are torn"),
        (run(240, lost=1), WARN, "1 of the 239 scans after the first lost track, and their poses are predictions"),
        (run(240, lost=100), FAIL, "100 of the 239 scans after the first lost track, and their poses are predictions"),
        (run(240, degenerate=60), WARN, "60 of the 239 scans after the first do not observe every direction of motion"),
        (run(240, degenerate=10), PASS, "no scan lost track"),
        (run(240, unread={7: None, 8: None}), WARN, "2 of 240 polar scans could not be read"),
        (
            run(240, refined=Refined([], [], 0.5, 0.6, 0.6)),
            FAIL,
            "psi per point across passes is 1.20 times its value before",
        ),
        (run(240, after=0.6, odometry_factors=0), PASS, "no scan lost track"),  # nothing pulled the graph anywhere
        (run(240, unoptimised="no luck"), FAIL, "the pose graph could not be optimised: the trajectory is psi's motions"),
        (run(240, before=0.0, after=0.0), PASS, "no scan lost track"),
        (
            run(240, after=pointmap(2.25, matched=0.0)),
            NOT_JUDGED,
            "no point of the map was seen by two",
        ),  # the radar stood still
        (run(240, before=PointMap.empty(), after=PointMap.empty()), PASS, "no scan lost track"),
        (run(18, torn=1), NOT_JUDGED, "1 of 3 windows is torn, too few to judge the map by"),
        (run(18, lost=1), WARN, "1 of the 17 scans after the first lost track, and their poses are predictions"),
        (run(18, lost=1), WARN, "0 of 3 windows are torn, too few to judge the map by"),
        (run(2), NOT_JUDGED, "2 scans are too few to judge a map by: a window takes 6"),
        (run(2, lost=1), NOT_JUDGED, "1 of the 1 scan after the first lost track, and their poses are predictions"),
        (run(3, lost=1, unread={1: None}), NOT_JUDGED, "3 scans are too few to judge a map by: a window takes 6"),
        (run(1), NOT_JUDGED, "1 scan is too few to judge a map by: a window takes 6"),
    ],
)
def test_the_verdict_of_a_run_needs_evidence(found, status, reason):
    verdict_status, _, reasons = verdict_of(judge_run(found))
    assert verdict_status is status, reasons
    assert any(said.startswith(reason) for said in reasons), reasons


@pytest.mark.parametrize(
    ("factors", "said"), [(0, "odometry would help there"), (239, "there the map rests on the odometry")]
)
def test_odometry_is_advised_where_the_scene_shows_too_little_only_if_there_is_none(factors: int, said: str) -> None:
    _, headline, _ = verdict_of(judge_run(run(240, degenerate=120, odometry_factors=factors)))
    assert headline.endswith(f"do not observe every direction of motion; {said}")


@pytest.mark.parametrize(
    ("after", "across", "status", "ratio", "meaning"),
    [
        (
            0.505,
            None,
            PASS,
            "1.01",
            "optimisation did not blur the map (a ratio above 1.1 would show that), but drift hardly shows",
        ),
        (0.6, None, FAIL, "1.20", "optimisation blurred the map, as a ratio above 1.1 shows"),
        (0.6, 0.45, PASS, "1.20", "it also counts the returns of other passes once the passes meet"),
    ],
)
def test_psi_per_point_says_that_it_hardly_sees_drift_and_psi_across_passes_leads(after, across, status, ratio, meaning):
    refined = Refined([], []) if across is None else Refined([], [], 0.9, 0.6, across)
    judged, _, reasons = verdict_of(judge_run(run(240, after=after, refined=refined)))
    said = f"psi per point is {ratio} times its value before optimisation: {meaning}"
    assert judged is status and any(reason.startswith(said) for reason in reasons)
    leads = "psi per point across passes is 0.50 times its value before optimisation"
    assert (reasons[0] == leads) is any("across passes is" in reason for reason in reasons) is (across is not None)


def test_stretches_that_are_near_each_other_are_one_warning() -> None:
    assert _warn_of_stretches("lost track", [(51.0, 51.03)]) == ["lost track at 51.0 s"]
    spans = [(1.0, 2.0), (13.8, 14.3), (14.5, 15.0), (19.9, 20.4), (25.4, 26.0)]
    assert _warn_of_stretches("lost track", spans) == [
        "lost track from 1.0 s to 2.0 s",
        "lost track in 3 stretches from 13.8 s to 20.4 s, 1.5 s in all",
        "lost track from 25.4 s to 26.0 s",
    ]


class Recorded(SimpleNamespace):
    """A recording of 20 scans."""

    def __len__(self) -> int:
        return 20


@pytest.mark.parametrize(("edges", "carried"), [(range(3), True), (range(2), False), (None, False)])
def test_velocities_by_chirps_are_said_to_carry_what_psi_does_not_observe(edges, carried):
    velocities = VelocityUse("chirps", (), None if edges is None else dict.fromkeys(edges))
    recording = Recorded(faults=[], gaps=list, start_times=np.arange(20.0), duration_s=20.0, sensor_name="radar", left_out=0)
    poses = SimpleNamespace(poses=np.c_[5.0 * np.arange(20.0), np.zeros((20, 2))])
    driven = run(20, degenerate=3, sensors=SensorUse(velocities=velocities), warnings=(), optimised=poses)
    (warning,) = list_warnings(driven, recording)
    told = "; velocities measured by chirps give the motion there" if carried else ""
    assert warning == f"the scans did not observe every direction from 0.0 s to 3.0 s{told}"


def test_of_many_gaps_the_first_are_named_and_the_others_counted() -> None:
    named = _warn_of_gaps([(k, 0.25) for k in range(12)], "radar")
    assert len(named) == 6
    assert named[0] == "radar gap of 0.25 s after scan 0 (counted from 0)"
    assert named[-1] == "7 more radar gaps; 3.00 s are missing in all"
    assert _warn_of_gaps([(4, 0.25)], "lidar") == ["lidar gap of 0.25 s after scan 4 (counted from 0)"]


@pytest.mark.parametrize("step_m", [0.25, 0.85, 1.0, 1.05, 4.0])
def test_a_trajectory_of_another_scale_than_odometry_does_not_pass(step_m: float) -> None:
    found, is_right = run(240, odometry=driven(240, step_m)), abs(np.log(step_m)) < 0.09
    status, _, reasons = verdict_of(judge_run(found))
    assert status is (PASS if is_right else WARN)
    said = [reason for reason in reasons if "times as fast as odometry" in reason]
    assert not said if is_right else f"{1.0 / step_m:.3g} times as fast" in said[0] and f"bins {step_m:.3g} times" in said[0]


def test_odometry_in_another_unit_is_told_and_range_bins_are_not_blamed_where_gnss_agrees_with_the_radar() -> None:
    (said,) = [
        reason
        for reason in verdict_of(judge_run(run(240, odometry=driven(240, 3.6)))).reasons
        if "as fast as odometry" in reason
    ]
    assert "as if its speeds were in km/h, or range bins 3.6 times as long" in said
    agreeing = SensorUse(fixes=FixUse("gnss.csv", (), None, None, 1.001))
    found = run(240, odometry=driven(240, 3.6), sensors=agreeing)
    (said,) = [reason for reason in verdict_of(judge_run(found)).reasons if "as fast as odometry" in reason]
    assert "in km/h, mend odometry's speeds, since GNSS agrees with the radar" in said and "range bins" not in said


def test_no_range_bins_are_blamed_for_the_scale_of_a_lidars_map() -> None:
    found = run(240, odometry=driven(240, 3.6), range_scale=NOT_OF_RADAR)
    (said,) = [reason for reason in verdict_of(judge_run(found)).reasons if "as fast as odometry" in reason]
    assert said.endswith("in km/h, or the ranges of the lidar are") and "bins" not in said


@pytest.mark.parametrize("stretch", [None, 0.8, 0.95, 1.05, 1.3])
def test_fixes_that_lie_farther_apart_than_the_trajectory_has_them_do_not_pass(stretch: float | None) -> None:
    fixes = FixUse("gnss.csv", (), None, None, stretch)
    status, _, reasons = verdict_of(judge_run(run(240, sensors=SensorUse(fixes=fixes))))
    said = [reason for reason in reasons if "GNSS fixes lie" in reason]
    assert (status, len(said)) == ((WARN, 1) if stretch in (0.8, 1.3) else (PASS, 0))
    unknown = list_unknowns(run(240, odometry_factors=0, sensors=SensorUse(fixes=fixes)), ASSUMED)
    assert bool(unknown) is (stretch is None)  # fixes that are refused for another reason show nothing


def turning(sign: float, axis: str = "z") -> GyroscopeUse:
    """Returns the use of a gyroscope that turns as the radar does, or the other way."""
    return GyroscopeUse("imu.csv", (), SimpleNamespace(), SimpleNamespace(axis=axis, sign=sign))


OPPOSITE = OdometryFault("the odometry is not used", is_opposite=True)
UNLIKE = OdometryFault("the odometry is not used", is_opposite=False)
MIRRORED, FITTING = FixUse("gnss.csv", (), is_mirrored=True), FixUse("gnss.csv", (), SimpleNamespace())


@pytest.mark.parametrize(
    ("used", "who"),
    [
        (SensorUse(odometry=OPPOSITE, gyroscope=turning(-1.0)), "odometry and the gyroscope turn"),
        (SensorUse(gyroscope=turning(-1.0), fixes=MIRRORED), "the gyroscope and GNSS turn"),
        (SensorUse(odometry=OPPOSITE, gyroscope=turning(-1.0), fixes=MIRRORED), "odometry, the gyroscope and GNSS turn"),
        (SensorUse(odometry=OPPOSITE, gyroscope=turning(-1.0), fixes=FITTING), "odometry and the gyroscope turn"),
        (SensorUse(odometry=OPPOSITE), None),
        (SensorUse(odometry=OPPOSITE, gyroscope=turning(1.0)), None),
        (SensorUse(odometry=UNLIKE, gyroscope=turning(-1.0)), None),
        (SensorUse(odometry=OPPOSITE, gyroscope=turning(-1.0, "x")), None),
    ],
)
def test_two_sensors_that_turn_the_other_way_than_the_radar_show_that_it_is_mirrored(
    used: SensorUse, who: str | None
) -> None:
    status, diagnosis, reasons = verdict_of(judge_run(run(240, sensors=used)))
    said = [reason for reason in reasons if "the map is mirrored" in reason]
    assert (status, len(said)) == ((PASS, 0) if who is None else (WARN, 1))
    assert who is None or (f"{who} the other way than the radar" in said[0] and "set sensor.clockwise: false" in diagnosis)


def test_on_what_the_scale_rests_is_said_where_nothing_is_held_against_it() -> None:
    stated = SimpleNamespace(is_resolution_assumed=False, range_resolution=0.0438)
    alone, beside = run(240, odometry_factors=0), run(240)
    assert "range bins of 0.0438 m, a value that is assumed: neither" in list_unknowns(alone, ASSUMED)[0]
    assert "range bins of 0.0438 m, a value that is stated: neither" in list_unknowns(alone, stated)[0]
    assert "an offset of all azimuths and a delay of all stamps" in list_unknowns(alone, stated)[1]
    assert list_unknowns(beside, stated) == list_unknowns(beside, ASSUMED) == []


def test_odometry_that_stands_or_is_short_shows_no_scale() -> None:
    assert measure_ratio(run(240, optimised=driven(240, 0.0), odometry=driven(240, 0.0))) is None
    assert measure_ratio(run(4)) is None and measure_ratio(run(240, odometry_factors=0)) is None
