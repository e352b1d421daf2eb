"""The constants that decide a covariance, and where each of them comes from.

The values are not written here: the page reads them from the modules. `tests/test_constants_page.py` fails if a constant
is gone, or if a new one has no row. Nobody should guess an origin: `not recorded` is the truth about a number whose origin
neither its comment nor the history of the repository tells.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mqslam.config import Config

ORIGINS = {
    "definition": "mathematics, the meaning of the word, or a guard against rounding that is far below any real error",
    "physics": "the construction of sensors and vehicles",
    "data": "measured on real recordings",
    "tuned": "chosen by what certain simulated worlds or recordings showed",
    "prior": "a stated belief about something that a recording may not show",
    "not recorded": "neither the comment beside the constant nor the repository's history says where the number comes from",
}
"""The origins that a constant may have, and what each of them means."""


class Constant(NamedTuple):
    """A constant that decides a covariance.

    Args:
        module: module that holds the constant; settings are in `mqslam.config`.
        name: name in the module; for a setting its section and its name, with a dot between them.
        decides: what the constant decides, with the unit of its value.
        origin: one of `ORIGINS`.
        on: what it was measured or tuned on; for other origins, a reason that explains the number, if there is one.
    """

    module: str
    name: str
    decides: str
    origin: str
    on: str = ""

    @property
    def value(self) -> Any:
        """The present value: a number, an array, a sequence or a mapping of numbers."""
        value: Any = Config() if self.module == "mqslam.config" else importlib.import_module(self.module)
        for part in self.name.split("."):
            value = getattr(value, part)
        return value

    def list_numbers(self) -> list[float]:
        """Returns the numbers of the value; those of the diagonal if it is a matrix."""
        value = list(self.value.values()) if isinstance(self.value, Mapping) else self.value
        numbers = np.asarray(value, dtype=np.float64)
        return np.ravel(np.diag(numbers) if numbers.ndim == 2 else numbers).tolist()


_FIRST_800 = "the first 800 scans of the twin's kaist01"
_LIDARS = (
    "the planar runs Intel and fr079, while runs of lidars were made; both also judge these runs, so that they prove less"
)
_CORRIDORS = "simulated buildings of long corridors, and the planar run Intel, which is also judged"
_SHARED_DRIFT = "the twin's kaist01, the city's seeds 1 to 3 and the first 800 scans of the twin's kaist02"
_RANGING = "simulated drives without a range offset: two cities (kind, hard) and two drives of the twin (kind, hard)"
_MOUNTS = "simulated streets; which ones is not recorded"
_GUARD = "a guard against rounding"

CONSTANTS = (
    # settings
    Constant(
        "mqslam.config", "estimator.sigma_range_m", "Standard deviation of a return along the ray [m].", "tuned", _FIRST_800
    ),
    Constant(
        "mqslam.config",
        "estimator.sigma_azimuth",
        "Standard deviation of a return across the ray [rad].",
        "tuned",
        _FIRST_800,
    ),
    Constant(
        "mqslam.config",
        "estimator.blur_m",
        "Standard deviation of the scatter of one object's returns between views [m].",
        "tuned",
        _FIRST_800,
    ),
    Constant(
        "mqslam.config",
        "estimator.cluster_m",
        "Side of the cells whose returns count as one object in a covariance by psi [m].",
        "tuned",
        "the twin's kaist01, by NEES",
    ),
    Constant(
        "mqslam.config",
        "tracker.sigma_omega",
        "Process noise: change of the yaw rate per 0.25 s that yaw acceleration does not explain [rad/s].",
        "not recorded",
        "0.12 was tuned on the first 800 scans of the twin's kaist01, before accelerations were in the state",
    ),
    Constant(
        "mqslam.config",
        "tracker.sigma_alpha",
        "Process noise: change of the yaw acceleration per 0.25 s [rad/s^2].",
        "not recorded",
    ),
    Constant(
        "mqslam.config",
        "tracker.speed_max",
        "Upper end of the speeds that are possible in a direction that psi does not observe [m/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.config",
        "odometry.sigma_travel",
        "Standard deviation of odometry's travel, as a share of it.",
        "not recorded",
    ),
    Constant(
        "mqslam.config", "odometry.sigma_yaw_rate", "Standard deviation of odometry's yaw rate [rad/s].", "not recorded"
    ),
    # robust statistics
    Constant("mqslam.core.statistics", "MEDIAN_OF_CHI2", "Ratio of a median of squares to the variance.", "definition"),
    Constant(
        "mqslam.core.statistics",
        "MEDIAN_SPREAD",
        "Relative standard deviation of a variance from the median of squares, times the root of their number.",
        "definition",
    ),
    Constant(
        "mqslam.core.statistics",
        "SIGMAS_PER_DEVIATION",
        "Ratio of the standard deviation to the median absolute deviation.",
        "definition",
    ),
    # the covariance of a minimum of psi
    Constant(
        "mqslam.psi.covariance",
        "_UNKNOWN",
        "Variance where there are no more objects than variables, in units of the inverse information: unknown.",
        "definition",
    ),
    Constant(
        "mqslam.psi.covariance",
        "_LEAST",
        "Share of Gauss-Newton's curvature at which the curvature is floored.",
        "definition",
        "it keeps the inverse of the curvature finite",
    ),
    Constant(
        "mqslam.psi.covariance",
        "_OBSERVED_SHARE",
        "Share of the curvature below which a direction counts as not observed, so that its variance becomes large.",
        "tuned",
        "the real Oxford sample, the twin, and the simulator's streets and bare corridor",
    ),
    Constant(
        "mqslam.psi.covariance",
        "_SIGNIFICANT",
        "Number of standard deviations by which a score must be larger than at its minimum to rule a state out.",
        "definition",
    ),
    Constant("mqslam.psi.covariance", "_SHOWN", "Relative eigenvalue below which an information is rounding.", "definition"),
    Constant("mqslam.psi.covariance", "_ROUNDING", "Floor of eigenvalues, relative to the largest.", "definition", _GUARD),
    Constant(
        "mqslam.psi.minimiser",
        "CORRELATION",
        "Number of returns that count as one measurement: divides psi's information where a prior is added.",
        "not recorded",
        "10 was tuned on the first 800 scans of the twin's kaist01; why it was halved is not recorded",
    ),
    Constant(
        "mqslam.psi.minimiser",
        "STABILISER",
        "Share of Gauss-Newton's curvature that is added to psi's curvature.",
        "tuned",
        _FIRST_800,
    ),
    Constant(
        "mqslam.psi.minimiser",
        "APART_BLUR",
        "Factor on the blur of a neighbour that was seen from a quite different direction.",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.minimiser",
        "_ASPECT_RAD",
        "Difference of viewing directions over which the blur grows by that factor [rad].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.window",
        "_UNKNOWN_SPEED",
        "Standard deviation of a window's speed in a direction that psi does not observe [m/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.window",
        "_UNKNOWN_YAW_RATE",
        "Standard deviation of a window's yaw rate where psi does not observe it [rad/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.window",
        "_TOLERANCES",
        "Floor of a window's standard deviations [m/s, m/s, rad/s]: the step that ends the search.",
        "definition",
        "far below psi's own noise",
    ),
    # Doppler shift and range offset
    Constant(
        "mqslam.psi.doppler",
        "_USUAL_SIGMA_S",
        "Standard deviation of the usual Doppler shift, which is joined with the measured one [s].",
        "physics",
        "carrier frequency over slope of the chirp of Navtech's radars",
    ),
    Constant(
        "mqslam.psi.doppler",
        "_STEP_S",
        "Standard deviation of the Doppler shift if a single stretch shows it [s]: the step between the shifts tried.",
        "not recorded",
    ),
    Constant("mqslam.psi.doppler", "_OF_MEDIAN", "Standard deviation of a median over that of the mean.", "definition"),
    Constant(
        "mqslam.psi.doppler",
        "_FINEST",
        "Floor of the standard deviation of the Doppler shift, as a share of the step between the shifts tried.",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.ranging",
        "_USUAL",
        "Standard deviations of the prior of range offset [m] and Doppler shift [s].",
        "prior",
        "weak, so that it only keeps a step finite",
    ),
    Constant(
        "mqslam.psi.ranging",
        "_ROBUST",
        "Distance, in units of the usual one, beyond which a stretch counts for less in mean and covariance.",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.ranging",
        "_MEDIAN",
        "Ratio of a median of squared distances to their scale, for two errors.",
        "definition",
    ),
    Constant(
        "mqslam.psi.ranging",
        "_DEPTH_M",
        "Standard deviation of the range offset by the depth of objects, added to that of the data [m].",
        "tuned",
        _RANGING,
    ),
    Constant(
        "mqslam.psi.ranging",
        "_SHIFT_S",
        "Standard deviation of the Doppler shift that is added to that of the data [s].",
        "tuned",
        _RANGING,
    ),
    # the tracker
    Constant(
        "mqslam.psi.tracking.state", "_NOISE_PERIOD_S", "Time for which the process noise is stated [s].", "definition"
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_SIGMA_VX",
        "Process noise: change of the forward speed per 0.25 s that acceleration does not explain [m/s].",
        "not recorded",
        "1.0 was tuned on the first 800 scans of the twin's kaist01, before accelerations were in the state",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "SIGMA_VY",
        "Process noise: change of the sideways speed per 0.25 s [m/s].",
        "tuned",
        _FIRST_800,
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "SIGMA_AX",
        "Process noise: change of the forward acceleration per 0.25 s [m/s^2].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "START_ALPHA",
        "Change of the yaw acceleration in the first scans of a track, and its standard deviation if unknown [rad/s^2].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_SIGMA_POSITION_M",
        "Process noise of the position at a scan's start per 0.25 s [m].",
        "tuned",
        _FIRST_800,
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_SIGMA_YAW",
        "Process noise of the yaw at a scan's start per 0.25 s [rad].",
        "tuned",
        _FIRST_800,
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_PERSISTENCE",
        "Share of an acceleration, and of its standard deviation, that is left after 0.25 s.",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "SPEED_MIN",
        "Lower end of the speeds that are possible in a direction that psi does not observe [m/s].",
        "physics",
        "vehicles hardly reverse faster",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "OMEGA_MAX",
        "Largest yaw rate that is possible where psi does not observe it [rad/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_FRAME",
        "Variances of a pose that defines the frame [m^2, m^2, rad^2]: zero but for rounding.",
        "definition",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "TOLERANCES",
        "Standard deviations with which a match is held along a direction that psi does not observe (units of the state).",
        "definition",
        "steps that end a search, far below any error",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_HALF",
        "Part of a motion's standard deviation that each of its poses gets.",
        "definition",
    ),
    Constant(
        "mqslam.psi.tracking.cold_start",
        "_AT_REST",
        "Standard deviations of twist [m/s, m/s, rad/s] and acceleration [m/s^2, rad/s^2] at a start that psi cannot see.",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.tracking.matching",
        "_START_OMEGA",
        "Process noise of the yaw rate in the first scans of a track, per 0.25 s [rad/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.psi.tracking.matching",
        "_DISTINCT_SIGMAS",
        "Rise of psi, in standard deviations, above which a direction counts as observed after all.",
        "tuned",
        "simulated bare corridors and simulated streets full of traffic",
    ),
    Constant(
        "mqslam.psi.tracking.tracker",
        "_SIGMA_SCALE",
        "Standard deviation of the distance across a gap, as a share of it.",
        "physics",
        "published lengths of one radar's range bins differ by 1.4 %, and a Doppler shift that is ignored costs as much",
    ),
    # front ends
    Constant(
        "mqslam.frontends.calibration",
        "_TRUSTED",
        "Number of motions that a front end's own covariances weigh as much as, where their scale is learnt.",
        "prior",
        "such covariances were off by a factor of three and more",
    ),
    Constant(
        "mqslam.frontends.calibration",
        "_GROSS",
        "Limit of squared differences, over their median, where the scale of covariances is learnt.",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.bidirectional",
        "SHARED",
        "Share of a motion's variance that both directions of time have in common.",
        "tuned",
        _SHARED_DRIFT,
    ),
    Constant(
        "mqslam.frontends.bidirectional",
        "SHARED_BY_LIDAR",
        "Share of the variance of a lidar's motion that both directions of time have in common.",
        "tuned",
        "simulated rooms of the tests, where the errors of both directions correlate by 0.79 to 0.92",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "UNSHOWN",
        "Standard deviations [m, m, rad] of a scan's pose along directions in which psi only followed odometry.",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.backend.sensors.odometry",
        "_CHANCE",
        "Squared difference over covariance beyond which a motion of odometry contradicts a lidar's scans.",
        "definition",
    ),
    Constant(
        "mqslam.frontends.bidirectional",
        "_CHANCE",
        "Squared difference of both directions, over its covariance, beyond which it enlarges the covariance.",
        "not recorded",
        "it is the quantile 0.999 of chi-square, but nothing says why this quantile",
    ),
    Constant(
        "mqslam.frontends.psi",
        "_GAIN",
        "Variance of a third difference of poses over that of a first difference.",
        "definition",
    ),
    Constant(
        "mqslam.frontends.psi",
        "_UNSTEADY_SCANS",
        "Number of scans that show the variance which the motion model leaves out.",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.psi",
        "_UNSTEADY_LEAST",
        "Number of scans below which the process noise stands in for a part of that variance.",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.odometry",
        "SIGMA_REST_M",
        "Standard deviation of odometry's position over a scan at rest [m].",
        "physics",
        "a wheel's encoder and its slack",
    ),
    Constant(
        "mqslam.frontends.scan_matching",
        "_COAST_VX",
        "Standard deviation of the forward speed where it is only predicted [m/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.scan_matching",
        "_COAST_VY",
        "Standard deviation of the sideways speed where it is only predicted [m/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.scan_matching",
        "_COAST_OMEGA",
        "Standard deviation of the yaw rate where it is only predicted [rad/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.icp_covariance",
        "_SURFACE_POINTS",
        "Number of map points that show how much a residual along the surface counts.",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.icp_covariance",
        "_FLATTEST",
        "Floor of a surface's variance across over that along: what a residual along it counts at least.",
        "not recorded",
    ),
    Constant(
        "mqslam.frontends.icp_covariance",
        "_LEAST_M",
        "Floor of residual and lever arm [m].",
        "definition",
        "below anything that is measured",
    ),
    Constant(
        "mqslam.frontends.kiss_icp",
        "_REACH",
        "Reach of the correspondences that enter KISS-ICP's covariance, in its adaptive thresholds.",
        "definition",
        "KISS-ICP's own",
    ),
    Constant(
        "mqslam.frontends.open3d_icp",
        "_REACH_M",
        "Reach, and width of the weights, of the correspondences that enter Open3D ICP's covariance [m].",
        "tuned",
        "smallest median drift in the hard cities of seeds 1 to 3",
    ),
    Constant(
        "mqslam.frontends.small_gicp",
        "_REACH_M",
        "Reach, and width of the weights, of the correspondences that enter small_gicp's covariance [m].",
        "tuned",
        "smallest median drift in the hard cities of seeds 1 to 3",
    ),
    # factors
    Constant(
        "mqslam.factors.between",
        "HUBER",
        "Residual of a motion, in standard deviations, beyond which its factor loses weight.",
        "definition",
        "95 % efficiency where errors are Gaussian",
    ),
    Constant(
        "mqslam.factors.between",
        "CAUCHY",
        "Residual of a loop, in standard deviations, beyond which its factor loses weight.",
        "not recorded",
    ),
    Constant(
        "mqslam.factors.between",
        "BEND_SIGMAS",
        "Standard deviations that are added to those of a loop, since submaps bend [m, m, rad].",
        "not recorded",
    ),
    Constant(
        "mqslam.factors.between",
        "PRIOR_M",
        "Standard deviation of the prior that holds the first position [m].",
        "definition",
        "it fixes the frame, and is far smaller than that of any motion",
    ),
    Constant(
        "mqslam.factors.between",
        "PRIOR_RAD",
        "Standard deviation of the prior that holds the first yaw [rad].",
        "definition",
        "it fixes the frame, and is far smaller than that of any motion",
    ),
    Constant(
        "mqslam.factors.between",
        "_LIFTED_M",
        "Standard deviation of z between poses in space [m].",
        "physics",
        "within a submap, roads bend by no more",
    ),
    Constant(
        "mqslam.factors.between",
        "_LIFTED_RAD",
        "Standard deviation of roll and pitch between poses in space [rad].",
        "physics",
        "within a submap, roads bend and springs give way by no more",
    ),
    Constant(
        "mqslam.factors.between", "_LEAST", "Variances added to those of a motion [m^2, m^2, rad^2].", "definition", _GUARD
    ),
    Constant(
        "mqslam.factors.gnss_position",
        "REACH",
        "Residual of a fix, in standard deviations, beyond which it counts as a jump.",
        "not recorded",
    ),
    Constant(
        "mqslam.factors.gnss_position",
        "_NO_TURN",
        "Standard deviation of the turn of the tangent plane, which does not turn [rad].",
        "definition",
        _GUARD,
    ),
    Constant(
        "mqslam.factors.gnss_position",
        "_UNKNOWN_YAW",
        "Standard deviation of a fix's yaw, which it does not measure [rad].",
        "definition",
    ),
    # the graph
    Constant(
        "mqslam.backend.submaps",
        "_SUBMAP_M",
        "Path along which scans share the errors of one submap [m].",
        "definition",
        "the path after which the running map takes a keyframe",
    ),
    Constant(
        "mqslam.backend.submaps",
        "_LEAST",
        "Variances added to those of a scan's pose in its submap [m^2, m^2, rad^2].",
        "definition",
        _GUARD,
    ),
    Constant(
        "mqslam.backend.range_scale",
        "STATED",
        "Standard deviation of the relative error of a stated length of the bins.",
        "prior",
        "lengths are stated to three or four digits",
    ),
    Constant(
        "mqslam.backend.range_scale",
        "ASSUMED",
        "Standard deviation of the relative error of the usual length of a format's bins.",
        "data",
        "lengths published for radars of Oxford and RADIATE, which differ by up to 1.4 %",
    ),
    Constant(
        "mqslam.backend.range_scale",
        "UNKNOWN",
        "Standard deviation of a scale that only other sensors show.",
        "definition",
    ),
    Constant(
        "mqslam.backend.range_scale",
        "_OFFSET_M",
        "Standard deviation of the range offset where psi does not show it [m].",
        "data",
        "the offset of Navtech's radars",
    ),
    Constant(
        "mqslam.backend.range_scale",
        "_LENGTHENING",
        "Relative change of lengths per metre of the range offset where psi does not show it [1/m].",
        "data",
        _RANGING,
    ),
    Constant(
        "mqslam.backend.submaps",
        "_DRIFT_SUBMAPS",
        "Number of submaps over which both directions of time are compared to learn the drift.",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.submaps",
        "_DRIFT_TRUSTED",
        "Number of such spans that the assumption of drift by the errors of scans weighs as much as.",
        "prior",
    ),
    Constant(
        "mqslam.backend.submaps",
        "_DRIFT_GROSS",
        "Limit of squared differences, over their median, where the drift is learnt.",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.loops.rigid",
        "TOLERANCES",
        "Standard deviations added to those of an audit's registration [m, m, rad]: the step that ends the search.",
        "definition",
        "a numerical tolerance",
    ),
    Constant(
        "mqslam.backend.refinement",
        "_SHARED",
        "Factor on the covariance of a scan that is registered on an earlier pass.",
        "prior",
        "the earlier pass's returns err as much as the scan's",
    ),
    # odometry and mount
    Constant(
        "mqslam.backend.sensors.calibration",
        "SPAN_S",
        "Longest span over which odometry's noise shows, and time between two values of its bias [s].",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "_ODOMETRY_BIAS_WALK",
        "Random walk of the bias of odometry's yaw rate in a second [rad/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "SIGMA_MOUNT_M",
        "Standard deviation of a stated position of the radar on the vehicle [m].",
        "physics",
        "a tape measure locates the point that wheels move without slip no better",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "SIGMA_MOUNT_RAD",
        "Standard deviation of a stated yaw of the radar on the vehicle [rad].",
        "data",
        "MulRan's calibration, which differs from straight ahead by as much",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "DELAY_S",
        "Standard deviation of the prior of a delay of odometry's or GNSS's clock [s].",
        "prior",
        "no usable clock is much later",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "MOUNT_M",
        "Standard deviation of the prior of the radar's distance from odometry's point, or from the antenna [m].",
        "prior",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "_BEYOND",
        "Miss of a span, in standard deviations, beyond which it is added to the variance of its motions.",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.calibration",
        "_UNKNOWN",
        "Variance of a motion that psi did not find [m^2, rad^2]: unknown.",
        "definition",
    ),
    Constant(
        "mqslam.backend.sensors.calibration", "_LEAST_SIGMA", "Floor of a prior's standard deviation.", "definition", _GUARD
    ),
    Constant(
        "mqslam.backend.sensors.odometry",
        "_UNKNOWN",
        "Variance of the yaw of odometry that was made with the gyroscope in the graph [rad^2]: unknown.",
        "definition",
    ),
    Constant(
        "mqslam.backend.sensors.odometry",
        "_LEAST_VARIANCE",
        "Variance added to those of odometry's motions [m^2, rad^2].",
        "definition",
        _GUARD,
    ),
    Constant(
        "mqslam.backend.sensors.mount",
        "_COMMON_M",
        "Standard deviation of the radar's position by errors of psi that all turns share [m].",
        "tuned",
        _MOUNTS,
    ),
    Constant(
        "mqslam.backend.sensors.mount", "_COMMON_RAD", "The same for the radar's yaw on the vehicle [rad].", "tuned", _MOUNTS
    ),
    Constant(
        "mqslam.backend.sensors.mount",
        "_LEAST_VARIANCE",
        "Variance added to those of motions where the mount is estimated [m^2, rad^2].",
        "definition",
        _GUARD,
    ),
    # gyroscope
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "LONGEST_DELAY_S",
        "Standard deviation of the prior of the delay of the gyroscope's clock, and the longest delay tried [s].",
        "data",
        "RADIATE, where the delay is 1.8 s",
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope", "KNOT_S", "Time between two values of the gyroscope's bias [s].", "not recorded"
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "_FIRST_WALK",
        "Largest random walk of the gyroscope's bias in a second [rad/s].",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "SIGMA_BIAS",
        "Standard deviation of the prior of the gyroscope's bias [rad/s].",
        "prior",
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "SIGMA_SCALE",
        "Standard deviation of the prior of the error of the gyroscope's scale.",
        "prior",
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "_SECOND_DIFFERENCE",
        "Variance of second differences of white noise over that of the noise.",
        "definition",
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope", "_LEAST", "Variance added to those of turns [rad^2].", "definition", _GUARD
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "_LEAST_WALK",
        "Floor of the walk between two biases [rad/s].",
        "definition",
        _GUARD,
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope",
        "_CONSTANT",
        "Walk of the gyroscope's scale, which is constant.",
        "definition",
        _GUARD,
    ),
    Constant(
        "mqslam.backend.sensors.gyroscope", "_LEAST_VARIANCE", "Floor of a turn's variance [rad^2].", "definition", _GUARD
    ),
    # GNSS
    Constant(
        "mqslam.backend.sensors.gnss_errors",
        "_ALIKE_S",
        "Longest time over which fixes show how their error wanders [s].",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.gnss",
        "_FIXES_OF_KNOT",
        "Number of fixes that share one value of the wandering error.",
        "tuned",
        "a real drive of RADIATE with GNSS",
    ),
    Constant(
        "mqslam.backend.sensors.gnss",
        "_LEAST_WALK_M",
        "Floor of the wandering between two values [m].",
        "definition",
        _GUARD,
    ),
    Constant("mqslam.backend.sensors.gnss_errors", "_LEAST_M", "Floor of the error of fixes [m].", "definition", _GUARD),
    Constant(
        "mqslam.backend.sensors.gnss_errors",
        "_JUMP",
        "Distance from the fixes around, over its median, beyond which a fix does not enter the walk.",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.gnss_errors",
        "_CONTRADICTION",
        "Difference, in standard deviations, beyond which longer means enlarge the walk.",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.gnss_errors",
        "_TURNED_RAD",
        "Standard deviation of the prior of the map's yaw where an antenna is estimated [rad].",
        "definition",
        "far larger than the error",
    ),
    Constant(
        "mqslam.backend.sensors.gnss_errors",
        "_SCALED",
        "Standard deviation of the prior of the trajectory's scale where an antenna is estimated.",
        "definition",
        "far larger than the error",
    ),
    # velocity by chirps
    Constant(
        "mqslam.backend.sensors.chirps",
        "_SPAN_S",
        "Shortest stretch over which errors of the calibration are common to all motions [s].",
        "not recorded",
    ),
    Constant(
        "mqslam.backend.sensors.chirps",
        "_SIGMA_BIAS_MPS",
        "Standard deviation of the prior of a velocity's bias [m/s].",
        "data",
        "Boreas-RT, whose bias is as large",
    ),
    Constant(
        "mqslam.backend.sensors.chirps",
        "SIGMA_SCALE",
        "Standard deviation of the prior of the error of the velocity's scale.",
        "physics",
        "the Doppler shift of chirps is known to a few percent",
    ),
    Constant(
        "mqslam.backend.sensors.chirps",
        "_UNKNOWN",
        "Standard deviation of a motion's yaw, which a velocity does not measure [rad].",
        "definition",
    ),
    Constant(
        "mqslam.backend.sensors.chirps", "_LEAST", "Variance added to those of velocities [m^2].", "definition", _GUARD
    ),
    # the registrations of an audit
    Constant(
        "mqslam.auditing.spans.pooled",
        "OWN_DRIFT_M",
        "Standard deviation of the drift of psi itself, over 100 m of path [m].",
        "tuned",
        _SHARED_DRIFT,
    ),
    Constant(
        "mqslam.auditing.spans.pooled",
        "OWN_DRIFT_RAD",
        "The same for the yaw [rad].",
        "tuned",
        _SHARED_DRIFT,
    ),
    Constant(
        "mqslam.auditing.spans.torn",
        "COMMON",
        "Variances per metre of path that are added for the drift of psi itself [m^2, m^2, rad^2].",
        "tuned",
        f"{_SHARED_DRIFT}, since it follows from OWN_DRIFT_M and OWN_DRIFT_RAD",
    ),
    Constant("mqslam.auditing.spans.torn", "_OF_MEDIAN", "Variance of a median of one, two or three spans.", "definition"),
    Constant(
        "mqslam.auditing.mending.evidence",
        "_LINE_MISS",
        "Share of a random walk's variance that a line through the walk misses at its ends.",
        "definition",
    ),
    Constant(
        "mqslam.auditing.mending.evidence",
        "_ANYWHERE_M2",
        "Variance of an unknown position [m^2].",
        "definition",
    ),
    Constant(
        "mqslam.auditing.mending.evidence",
        "_LEAST_VARIANCE",
        "Floor of the variance of steps [m^2, rad^2].",
        "definition",
        _GUARD,
    ),
    Constant(
        "mqslam.auditing.mending.tied_chain",
        "_MEDIAN",
        "Ratio of a median of squared distances to their scale, for a pose.",
        "definition",
    ),
    Constant(
        "mqslam.auditing.spans.pooled",
        "_OWN_YAW",
        "Standard deviation of the drift of psi's own yaw per root of a metre [rad].",
        "tuned",
        f"{_SHARED_DRIFT}, since it follows from OWN_DRIFT_RAD",
    ),
    Constant(
        "mqslam.psi.tracking.local_map",
        "SURFACES",
        "Settings for matching a lidar's scans to their map, in the order of `Tuning`.",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.backend.loops.passes",
        "_WIDENED",
        "Multiple of the spread along a surface that is added to the covariance of a lidar's point in a pass.",
        "tuned",
        _CORRIDORS,
    ),
    Constant(
        "mqslam.backend.loops.passes",
        "_FEW",
        "Number of a lidar's points around a point below which it stands alone, and shows nothing by itself.",
        "definition",
        "a surface that ends at a point holds more points within this distance, by their spacing",
    ),
    Constant(
        "mqslam.backend.loops.passes",
        "_AROUND_M",
        "Distance up to which a lidar's points show the surface of a point [m, in the recording's unit].",
        "tuned",
        _CORRIDORS,
    ),
    Constant(
        "mqslam.backend.loops.free_space",
        "_CELL_M",
        "Side of a cell of the image of free space in which a lidar's passes are compared [m, in the recording's unit].",
        "tuned",
        _CORRIDORS,
    ),
    Constant(
        "mqslam.backend.loops.free_space",
        "_DEEPEST_M",
        "Depth in free space beyond which a point costs no more [m, in the recording's unit].",
        "tuned",
        _CORRIDORS,
    ),
    Constant(
        "mqslam.backend.loops.free_space",
        "_NEIGHBOURS",
        "Angle between beams, in usual angles, up to which the space between them is free.",
        "tuned",
        _CORRIDORS,
    ),
    Constant(
        "mqslam.backend.loops.free_space",
        "_SIDE_M",
        "Distance from the best place to the places that give the curvature of its cost [m, in the recording's unit].",
        "tuned",
        _CORRIDORS,
    ),
    Constant(
        "mqslam.backend.loops.registration",
        "_OPEN_M",
        "Standard deviation of a position that two passes do not show [m].",
        "definition",
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_GUIDE_M",
        "Standard deviation of odometry between two scans of a lidar, without motion [m, in the recording's unit].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_GUIDE_RAD",
        "The same for the yaw [rad].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "_GUIDE_SHARE",
        "Its part that grows with the motion, as a share of it.",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.psi.tracking.state",
        "CONTRADICTED",
        "Covariance added where a scan does not fit where odometry puts it [m^2, m^2, rad^2, in the recording's unit].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.backend.sensors.odometry",
        "_WORTHLESS",
        "Covariance added to odometry that a lidar's scans contradict [m^2, m^2, rad^2, in the recording's unit].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_STEEPEST_RAD",
        "Angle between beam and normal up to which neighbouring beams of a lidar hit one surface [rad].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_WIDEST_STEP",
        "Angle between beams, in usual steps, above which a beam between them saw nothing.",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_NEAR",
        "Distance of neighbouring returns up to which they always lie on one surface, in spacings of points.",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_USUAL_RANGE_M",
        "Range of what a radar usually sees [m]; a lidar's usual range over it is the unit of its recording.",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_SPACING",
        "Distance between points along a surface [m, in the recording's unit].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_PATH",
        "Path after which a scan is solved [m, in the recording's unit].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_TURN_RAD",
        "Turn after which a scan is solved [rad].",
        "tuned",
        _LIDARS,
    ),
    Constant(
        "mqslam.detection.surfaces",
        "_CHANGED",
        "Share of ranges that differ once the lidar has moved, whatever odometry says.",
        "tuned",
        _LIDARS,
    ),
)
"""All constants that decide a covariance of a measurement, of a sensor's calibration or of the graph."""
