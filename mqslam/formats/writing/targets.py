"""The layouts that can be written, and which of them a path stands for."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

from mqslam.errors import ConfigError, OutputError
from mqslam.execution.folders import check_free, check_writable
from mqslam.formats.writing.bags import KINDS


@dataclass(frozen=True, slots=True)
class Target:
    """A layout that recordings can be written in.

    Args:
        name: as `--to` takes it.
        suffix: of the file, "" for a folder.
        odometry: whether it has a place for odometry.
        truth: whether it has one for ground truth.
        validity: whether it can say that an azimuth was not measured.
    """

    name: str
    suffix: str = ""
    odometry: bool = False
    truth: bool = True
    validity: bool = True

    @property
    def is_bag(self) -> bool:
        """Whether it is a bag of ROS."""
        return self.name in KINDS


_ALL = (
    Target("oxford", odometry=True),
    Target("boreas"),
    Target("mulran", validity=False),
    Target("mulran_oxford"),
    Target("radiate", truth=False, validity=False),
    Target("rosbag1", ".bag", odometry=True),
    Target("mcap", ".mcap", odometry=True),
    Target("rosbag2", odometry=True),
    Target("rosbag2_mcap", odometry=True),
    Target("native", ".npz", odometry=True),
)
TARGETS = {target.name: target for target in _ALL}


def target_of(out: Path, to: str | None) -> Target:
    """The layout that a path is to be written in: the one that is named, else by the suffix; a folder is Oxford's.

    Raises:
        ConfigError: a layout nobody knows, or a file whose suffix says something else.
    """
    by_suffix = {target.suffix: target for target in reversed(_ALL)}
    if to is None:
        if out.suffix not in by_suffix:
            remedy = "end it in .bag, .mcap or .npz, or name a layout by --to"
            raise ConfigError(f"{out}: '{out.suffix}' is the suffix of no layout; {remedy}")
        return by_suffix[out.suffix]
    if to not in TARGETS:
        near = difflib.get_close_matches(to.lower(), TARGETS, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'? " if near else ""
        raise ConfigError(f"--to '{to}': is unknown; {hint}known: {', '.join(TARGETS)}")
    target = TARGETS[to]
    if target.suffix and out.suffix != target.suffix:
        raise ConfigError(f"{out}: {to} is a file that ends in {target.suffix}; name it so, or give another --to")
    return target


def check_target(out: Path, target: Target, *, force: bool, recording: Path) -> None:
    """See that a result may be written before time is spent on it.

    Args:
        out: where it goes.
        target: its layout.
        force: whether what is there may be replaced.
        recording: what it is made from, which must not be replaced by it.

    Raises:
        OutputError: something is there and may not be replaced, or it cannot be written.
    """
    if not target.suffix:
        check_free(out, force=force, recording=recording)
        return
    if out.is_dir() or (out.exists() and not force):
        how = "choose another output" if out.is_dir() else "choose another output or give --force to replace it"
        raise OutputError(f"{out}: exists already; {how}")
    if out.resolve() == recording.resolve():
        raise OutputError(f"{out}: is the recording itself; choose another output")
    check_writable(out)
