"""The KISS-ICP front end: a rival method on the same returns, set up as well as possible for radar."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError

from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.errors import ConfigError, untrusted
from mqslam.frontends.icp_covariance import Surface
from mqslam.frontends.scan_matching import (
    FEWEST_MATCHED,
    Matching,
    MatchingFrontEnd,
    PlacedScan,
    from_matrix,
    lift,
    to_matrix,
)

_FAR_M = 1e6  # beyond every range that KISS-ICP keeps
# Share of a scan's returns, and side of the map's voxels [m], with which the front end drifts least on its tuning drives.
STRONGEST, VOXEL_M = 0.7, 1.0
_REACH = 3.0  # KISS-ICP looks for correspondences within this many of its adaptive thresholds: its definition


class KissIcpFrontEnd(MatchingFrontEnd):
    """A front end that matches each scan, as a planar point cloud with a time per point, with KISS-ICP.

    KISS-ICP begins at rest and predicts by its last motion, so that it would lose the first scans of a recording that begins
    while the vehicle drives. The front end therefore finds the first motion (`MatchingFrontEnd`): KISS-ICP runs
    over the first scans forwards and then backwards in time, from odometry's speed or else from several speeds, and starts
    with the slowest motion that fits about as well as the best. Nothing is taken from psi except the radar's Doppler shift,
    which is removed from the ranges with the help of the last motion.

    KISS-ICP deskews a scan to the scan's end, where the next scan begins. Without deskewing, the pose that KISS-ICP finds is
    the pose at half the scan's duration.

    Args:
        context: settings, Doppler shift and odometry.

    Raises:
        ConfigError: the YAML file of KISS-ICP's own settings is missing or invalid.
    """

    def __init__(self, context: Context) -> None:
        settings = Matching.of(context, STRONGEST, VOXEL_M)
        config = make_config(settings, context.config.kiss_icp.config_file)
        super().__init__(context, settings.strongest, lambda: _KissIcpMatcher(config))


class _KissIcpMatcher:
    """KISS-ICP as a `ScanMatcher`, which is given the pose and the predicted motion with every scan."""

    def __init__(self, config: Any) -> None:
        from kiss_icp.kiss_icp import KissICP

        self._kiss = KissICP(config)
        self.reference = 1.0 if config.data.deskew else 0.5  # a scan that is not deskewed fits best at half its duration

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> PlacedScan | None:
        """Matches a scan, and adds it to the map; see `ScanMatcher`.

        A scan that hardly matches once it is registered has already joined the map, at the registered pose.
        """
        kiss, voxel_size = self._kiss, self._kiss.config.mapping.voxel_size
        # KISS-ICP takes the earliest and the latest point as the ends of a scan: two points too far to be kept mark the ends
        frame = lift(np.vstack([points, [[_FAR_M, 0.0], [_FAR_M, 0.0]]]))
        deskewed = kiss.preprocessor.preprocess(frame, np.r_[fractions, 0.0, 1.0], to_matrix(motion))
        source, joining = kiss.voxelize(deskewed)
        scan, predicted = source[:, :2], se2.compose(before, motion)
        kernel = kiss.adaptive_threshold.get_threshold()
        reach = _REACH * kernel
        surface = None if kiss.local_map.empty() else Surface(kiss.local_map.point_cloud()[:, :2], voxel_size)
        # with only a few correspondences the linear system is singular, and KISS-ICP aborts the process
        if surface is None or surface.count_matched(scan, predicted, reach) < FEWEST_MATCHED:
            kiss.local_map.update(joining, to_matrix(predicted))
            return None
        # these are the other steps of KISS-ICP's register_frame, which itself would deskew and thin the scan again
        guess = to_matrix(predicted)
        placed = kiss.registration.align_points_to_map(source, kiss.local_map, guess, reach, kernel)
        kiss.adaptive_threshold.update_model_deviation(np.linalg.inv(guess) @ placed)
        kiss.local_map.update(joining, placed)
        pose = from_matrix(placed)
        if surface.count_matched(scan, pose, reach) < FEWEST_MATCHED:
            return None
        near = surface.count_matched(scan, pose, voxel_size) / len(scan)
        return PlacedScan(pose, partial(surface.compute_covariance, scan, pose, reach, kernel), near)


def make_config(settings: Matching, own: Path | None = None) -> Any:
    """Makes KISS-ICP's own settings (a KISSConfig) from the settings of matching, or only from the file `own` if given.

    Raises:
        ConfigError: the file cannot be read, or does not hold valid settings of KISS-ICP.
    """
    from kiss_icp.config import KISSConfig

    if own is not None:
        return _load_config(own)
    config = KISSConfig()
    config.mapping.voxel_size = settings.voxel_size_m
    config.data.max_range = settings.max_range_m
    config.data.min_range = 0.0
    return _make_repeatable(config)


def _make_repeatable(config: Any) -> Any:
    """Sets 1 thread in a KISSConfig that leaves the number open (0), because several threads add up in varying order.

    The first KISS-ICP object of a process decides how many threads all KISS-ICP objects of this process have.
    """
    config.registration.max_num_threads = config.registration.max_num_threads or 1
    return config


def _load_config(path: Path) -> Any:
    """Reads a file of KISS-ICP's settings by KISS-ICP's loader, and refuses unknown settings, which the loader ignores.

    Raises:
        ConfigError: the file cannot be read, or does not hold valid settings of KISS-ICP.
    """
    from kiss_icp.config import KISSConfig, load_config
    from kiss_icp.kiss_icp import KissICP

    try:
        tree = yaml.safe_load(untrusted.read_document(path, untrusted.YAML_BYTES))
        config = _make_repeatable(load_config(path))
        KissICP(config)  # refuses values that the loader accepts, such as null for a number
    except (OSError, UnicodeDecodeError, yaml.YAMLError, TypeError) as error:
        raise ConfigError(f"{path}: is not a YAML file of KISS-ICP's settings ({str(error).splitlines()[0]})") from error
    except ValidationError as error:
        fault = error.errors()[0]
        where = ".".join(str(part) for part in fault["loc"])
        raise ConfigError(f"{path}: {where}: {fault['msg']}") from error
    for section, values in (tree or {}).items():
        known: dict[str, Any] = getattr(KISSConfig.model_fields[section].annotation, "model_fields", {})
        unknown = [key for key in values if key not in known] if known else []
        if unknown:
            raise ConfigError(f"{path}: unknown setting {section}.{unknown[0]}; choose one of {', '.join(known)}")
    for name, value in (("mapping.voxel_size", config.mapping.voxel_size), ("data.max_range", config.data.max_range)):
        if not value > 0.0:
            raise ConfigError(f"{path}: {name}: must be greater than 0")
    return config
