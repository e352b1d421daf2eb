"""The KISS-ICP front end: the rival on the same returns, as good as it gets on radar."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import ValidationError

from mqslam.config import KissIcpConfig
from mqslam.core import se2
from mqslam.core.frontend import Context
from mqslam.core.measurement import Measurement
from mqslam.core.scans import Scan
from mqslam.errors import ConfigError
from mqslam.frontends.icp_covariance import Surface
from mqslam.frontends.scan_matching import FEWEST, Match, in_space, matrix_of, motions, pose_of

INFLATION = 86.0  # variance of a pose over s^2 H^-1; makes mean NEES/3 one on kaist01, and 0.88 on kaist02
_FAR_M = 1e6  # beyond every range KISS-ICP keeps


class KissIcpFrontEnd:
    """Feeds each revolution to KISS-ICP as a planar scan with per-point times.

    KISS-ICP begins at rest and predicts by its last motion, so that it loses the first revolutions of a recording that
    begins on the move. Here it finds its first motion itself, from the first ten revolutions (`scan_matching.motions`):
    it runs over them forwards and then backwards in time, from several speeds, and starts with the motion whose scans
    fitted best. Nothing of psi helps it but the radar's Doppler shift, which is taken out of the ranges by its last motion.

    It deskews a scan to its end, so that its pose is the sensor's where the next revolution begins.

    Raises:
        ConfigError: a YAML file of KISS-ICP's own that is missing or none.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._config = _kiss_config(context.config.kiss_icp)

    def measure(self, scans: Iterable[Scan]) -> Iterator[Measurement]:
        """The motion from the start of each window to the start of the next.

        Raises:
            EstimationError: fewer than two revolutions, or hardly any returns in the first ones.
        """
        return motions(scans, lambda: _KissIcpMatcher(self._config), self._context, INFLATION)


class _KissIcpMatcher:
    """KISS-ICP behind the protocol of `scan_matching`; pose and motion are handed to it with every scan."""

    def __init__(self, config: Any) -> None:
        from kiss_icp.kiss_icp import KissICP

        self._kiss = KissICP(config)
        self.reference = 1.0 if config.data.deskew else 0.5  # a scan that is not deskewed fits best in its middle

    def match(
        self, points: NDArray[np.float64], fractions: NDArray[np.float64], before: se2.Array, motion: se2.Array
    ) -> Match | None:
        kiss = self._kiss
        kiss.last_pose, kiss.last_delta = matrix_of(before), matrix_of(motion)
        # KISS-ICP takes the first and the last time of a scan for its ends: points too far to be kept mark those
        frame = in_space(np.vstack([points, [[_FAR_M, 0.0], [_FAR_M, 0.0]]]))
        times = np.r_[fractions, 0.0, 1.0]
        source, joining = kiss.voxelize(kiss.preprocessor.preprocess(frame, times, kiss.last_delta))
        scan = source[:, :2]
        predicted = se2.compose(before, motion)
        kernel = kiss.adaptive_threshold.get_threshold()
        reach = 3.0 * kernel
        surface = None if kiss.local_map.empty() else Surface(kiss.local_map.point_cloud()[:, :2])
        # with no more than a few correspondences its linear system is singular, and it aborts the process
        if surface is None or surface.matched(scan, predicted, reach) < FEWEST:
            kiss.local_map.update(joining, matrix_of(predicted))
            return None
        kiss.register_frame(frame, times)
        pose = pose_of(kiss.last_pose)
        if surface.matched(scan, pose, reach) < FEWEST:
            return None
        near = surface.matched(scan, pose, kiss.config.mapping.voxel_size) / len(scan)
        return Match(pose, surface.covariance(scan, pose, reach, kernel), near)


def _kiss_config(settings: KissIcpConfig) -> Any:
    """The KISSConfig of the settings, or of the file of KISS-ICP's own that they name."""
    from kiss_icp.config import KISSConfig

    if settings.config_file is not None:
        return _loaded(settings.config_file)
    config = KISSConfig()
    config.mapping.voxel_size = settings.voxel_size_m
    config.data.max_range = settings.max_range_m
    config.data.min_range = 0.0
    config.data.deskew = settings.deskew
    return _repeatable(config)


def _repeatable(config: Any) -> Any:
    """A KISSConfig whose 0 threads, which means any number, are one: many add up in any order.

    The first KISS-ICP of a process says how many threads all of them have.
    """
    config.registration.max_num_threads = config.registration.max_num_threads or 1
    return config


def _loaded(path: Path) -> Any:
    """A file of KISS-ICP's own, read by its own loader, which ignores settings it does not know within a section."""
    from kiss_icp.config import KISSConfig, load_config
    from kiss_icp.kiss_icp import KissICP

    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
        config = _repeatable(load_config(path))
        KissICP(config)  # refuses what the loader lets pass, such as null for a number
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
            raise ConfigError(f"{path}: unknown setting {section}.{unknown[0]}; known are {', '.join(known)}")
    for name, value in (("mapping.voxel_size", config.mapping.voxel_size), ("data.max_range", config.data.max_range)):
        if not value > 0.0:
            raise ConfigError(f"{path}: {name}: must be greater than 0")
    return config
