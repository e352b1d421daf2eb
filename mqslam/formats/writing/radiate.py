"""Writes the layout RADIATE: `Navtech_Polar/000001.png`, one column per azimuth, arrival stamps in `Navtech_Polar.txt`."""

from __future__ import annotations

from pathlib import Path

from mqslam.core.recording import Recording
from mqslam.execution.files import write_text
from mqslam.formats.writing.columns import write_columns


def write(folder: Path, recording: Recording) -> list[str]:
    """Write a recording into an empty folder, one revolution in memory at a time.

    Returns:
        What a user should know about what was lost.

    Raises:
        DataError: a revolution that cannot be read, or that polar images cannot hold.
    """
    names = [f"{number:06d}" for number in range(1, len(recording) + 1)]
    lines = [
        f"Frame: {name} Time: {end // 1_000_000}.{end % 1_000_000:06d}000\n"
        for name, end in zip(names, recording.ends_us.tolist(), strict=True)
    ]
    write_text(folder / "Navtech_Polar.txt", "".join(lines))
    images = folder / "Navtech_Polar"
    images.mkdir()
    return write_columns(images, recording, names)
