"""The results of SLAM: the optimised trajectory, its pose graph, and the maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam

from mqslam.auditing.judge import Audit
from mqslam.auditing.windows.windows import WindowAudit
from mqslam.backend.loops.passes import MappedDrive
from mqslam.backend.loops.recognition import describe_places
from mqslam.backend.marginals import PoseCovariances
from mqslam.backend.pose_graph import PoseGraph, scale_graph, scale_values
from mqslam.backend.range_scale import RangeScale
from mqslam.backend.sensor_use import SensorUse
from mqslam.backend.sensors.odometry import ODOMETRY
from mqslam.config import Config
from mqslam.core import se2, units
from mqslam.core.engine import Engine
from mqslam.core.keyframes import KeyframeMap, MappedRecording
from mqslam.core.measurement import Loop, Measurement, Refined
from mqslam.core.point_map import PointMap
from mqslam.core.recording import Recording
from mqslam.core.scans import Scans
from mqslam.core.sensors import Georeference, Mount
from mqslam.core.trajectory import Trajectory
from mqslam.core.wording import count_of
from mqslam.errors import DataError
from mqslam.mapping.keyframing import make_keyframes
from mqslam.psi.place import Beam, beam_of
from mqslam.psi.ranging import RangeErrors

CHECK = "the check of the map"
"""Name of the part of a run that judges its map."""


@dataclass(frozen=True)
class Solution:
    """The trajectory estimated from a recording's scans, with the settings, measurements and factors behind it.

    Args:
        frontend: name of the front end.
        config: all settings, as they were given.
        doppler_beta: range shift per closing speed [s], from the settings or as measured.
        doppler_sigma: standard deviation of `doppler_beta` [s] if it was measured, else zero.
        measurements: the front end's relative motions, one per pair of successive scans.
        odometry: trajectory before loops and sensors are added: the given odometry, or the front end's motions, chained
            without optimisation, if there is no odometry that can be used.
        optimised: trajectory after optimisation.
        graph: all factors, with the starting values of the optimisation.
        values: the optimised values.
        covariances: covariances of all optimised poses, or the reason why they are unknown.
        odometry_factors: number of odometry edges in the graph.
        loops: all loop closures that were found; where the refinement has measured the same passes, the refinement's ties
            replace these loops in the graph.
        loops_rejected: number of pairs of scans that were compared but are no loop.
        refined: result of the refinement that follows the loop closures, including psi across passes.
        sensors: the use of each of the other sensors, or the reason why it is not used.
        range_errors: range offset and Doppler shift of the radar as psi measured them before other sensors were joined; None
            if psi could not measure them.
        range_scale: the scale of the ranges; measurements, trajectories and maps are made with its factor.
        unoptimised: why the graph could not be optimised and its starting values were kept, or None.
        warnings: sentences for the user on steps that failed or data that are not used, with the reasons.
    """

    frontend: str
    config: Config
    doppler_beta: float
    doppler_sigma: float
    measurements: Sequence[Measurement]
    odometry: Trajectory
    optimised: Trajectory
    graph: PoseGraph
    values: gtsam.Values
    covariances: PoseCovariances
    odometry_factors: int
    loops: list[Loop]
    loops_rejected: int
    refined: Refined
    sensors: SensorUse
    range_errors: RangeErrors | None
    range_scale: RangeScale
    unoptimised: str | None
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<{type(self).__name__}, {self.frontend}, {count_of(len(self.loops), 'loop')}, {self.optimised!r}>"

    @property
    def beam(self) -> Beam:
        """The sensor model by which the returns were placed."""
        return beam_of(self.config.estimator, self.doppler_beta)

    @property
    def georeference(self) -> Georeference | None:
        """The pose of the optimised map on the Earth; None unless GNSS is in the graph."""
        fixes = self.sensors.fixes
        return None if fixes is None or fixes.edges is None else fixes.edges.find_place(self.values)

    def scale(self, factor: float, config: Config) -> Solution:
        """Returns the solution in another unit of length; the solution must use no sensors besides odometry.

        Args:
            factor: multiplier of all lengths.
            config: all settings in the new unit.
        """
        covariances = replace(self.covariances, covariances=units.scale_covariance(self.covariances.covariances, factor))
        return replace(
            self,
            config=config,
            measurements=[units.scale_measurement(motion, factor) for motion in self.measurements],
            odometry=units.scale_track(self.odometry, factor),
            optimised=units.scale_track(self.optimised, factor),
            graph=scale_graph(self.graph, factor),
            values=scale_values(self.values, factor),
            covariances=covariances,
            loops=[units.scale_tie(loop, factor) for loop in self.loops],
            refined=units.scale_refined(self.refined, factor),
            sensors=replace(self.sensors, mount=None),
        )

    def keep_map(self, scans: Scans, recording: Recording, engine: Engine) -> KeyframeMap:
        """Makes the keyframes of the optimised map, and descriptors by which its places are recognised.

        Args:
            scans: scans of the recording.
            recording: the recording.
            engine: engine that describes the places; the result does not depend on the choice of the engine.
        """
        span = recording.start_us, recording.end_us
        unit_m = scans.unit_m
        source = MappedRecording(str(recording.path), *span, recording.revolution_s, self.doppler_beta, unit_m)
        known = self.covariances.failure is None and len(self.covariances.indices) == len(self.optimised)
        factor = 1.0 / (unit_m or 1.0)
        covariances = units.scale_covariance(self.covariances.covariances, factor) if known else None
        beam = beam_of(units.scale_settings(self.config, factor).estimator, self.doppler_beta)
        poses = units.scale_pose(self.optimised.poses, factor)
        keyframes = make_keyframes(scans.scale_ranges(factor), poses, covariances, source, beam)
        made = KeyframeMap(keyframes, describe_places(MappedDrive.of(keyframes), beam, engine))
        return made.scale(unit_m or 1.0)

    @property
    def before(self) -> str:
        """Name of the trajectory `odometry`, for tables: `odometry`, or the front end's name with `, chained`."""
        return ODOMETRY if self.odometry_factors or self.frontend == ODOMETRY else f"{self.frontend}, chained"


@dataclass(frozen=True, repr=False)
class Run(Solution):
    """The result of a finished run: the trajectory, its maps, and the check of the map.

    Args:
        map_odometry: the recording rendered under the trajectory before optimisation.
        map_optimised: the recording rendered under the optimised trajectory.
        kept: the keyframes of the optimised map; None if the keyframes could not be made.
        checked: audit of the optimised map, with a sample of its windows; None if the audit could not be made.
        runtime_s: runtime of each stage [s].
        unread: the error for each polar scan that could not be read and was left out, by the scan's index in the recording.
        crashes: error message of each part that could not be made, by the name of the part.
        mount: pose of the radar on the vehicle, if trajectories, covariances and maps belong to the vehicle, in the frame
            of its first pose; None if they belong to the radar.
    """

    map_odometry: PointMap
    map_optimised: PointMap
    kept: KeyframeMap | None
    checked: Audit | None
    runtime_s: dict[str, float]
    unread: dict[int, DataError]
    crashes: Mapping[str, str]
    mount: Mount | None = None

    @property
    def georeference(self) -> Georeference | None:
        """The pose of the optimised map on the Earth; None unless GNSS is in the graph."""
        place = super().georeference
        return place if place is None or self.mount is None else place.carry(self.mount.pose)

    def carry_to_vehicle(self, mount: Mount) -> Run:
        """Returns the run with the trajectories, covariances and maps of the vehicle, in the frame of its first pose.

        Graph, measurements, loops and checks stay the radar's. Places on the Earth do not move.
        """
        start = mount.pose  # pose of the run's frame, the radar's first pose, in the frame of the vehicle's first pose
        tracks = [mount.carry_to_vehicle(track) for track in (self.odometry, self.optimised)]
        odometry, optimised = (Trajectory(track.stamps_us, se2.compose(start, track.poses)) for track in tracks)
        return replace(
            self,
            odometry=odometry,
            optimised=optimised,
            covariances=self.covariances.carry(mount.pose),
            map_odometry=self.map_odometry.carry(start),
            map_optimised=self.map_optimised.carry(start),
            kept=None if self.kept is None else self.kept.carry(start),
            mount=mount,
        )

    @property
    def checks(self) -> list[WindowAudit]:
        """The windows of the optimised map that the audit judged, evenly spread over the run."""
        return self.checked.windows if self.checked else []
