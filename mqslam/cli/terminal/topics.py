"""The topics of a bag that --topic names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mqslam.config import Config

_SETTINGS: Final = {"radar": "radar_topic", "odometry": "odometry_topic", "truth": "truth_topic"}


def state_topics(settings: Config, topics: Sequence[str] | None) -> Config:
    """Returns settings that name the topics of a bag.

    Args:
        settings: of the command.
        topics: TOPIC for the radar's, or radar=TOPIC, odometry=TOPIC or truth=TOPIC; None names none.

    Raises:
        ConfigError: a topic is of nothing known, is empty, or is named twice.
    """
    from mqslam.config import set_sensor
    from mqslam.errors import ConfigError, suggest

    named: dict[str, str] = {}
    for text in topics or ():
        of, equals, topic = text.partition("=")
        if not equals:
            of, topic = "radar", text
        if of not in _SETTINGS:
            raise ConfigError(f"--topic {text}: is of nothing that is read; {suggest(of, _SETTINGS)}")
        if not topic or _SETTINGS[of] in named:
            problem = "names the topic twice" if topic else "names no topic"
            raise ConfigError(f"--topic {text}: {problem}; give each as {of}=TOPIC, once")
        named[_SETTINGS[of]] = topic
    return set_sensor(settings, **named)
