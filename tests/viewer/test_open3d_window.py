"""The window opens, shows the run, changes colour by key, and ends when it is told to."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

COMMAND = Path(sys.executable).with_name("mqslam")
PROGRAM = """
import json, sys
from pathlib import Path
import numpy as np
import open3d as o3d
from mqslam.viewer.open3d_window import open_window
from mqslam.viewer.scene import LOOPS, TRAJECTORY, colour_over_span, read_scene

pressed = {}

def register(self, key, call):
    pressed[chr(key)] = call

o3d.visualization.VisualizerWithKeyCallback.register_key_callback = register
scene = read_scene(Path(sys.argv[1]))
shown = open_window(scene, "psi")

def seen():
    shown.poll_events()
    shown.update_renderer()
    picture = np.round(255.0 * np.asarray(shown.capture_screen_float_buffer(True))).astype(int)
    wanted = {"trajectory": [TRAJECTORY], "loops": [LOOPS], **{n: colour_over_span(v) for n, v in scene.values.items()}}
    return {
        name: sum(bool((np.abs(picture - np.asarray(c, dtype=int)).max(axis=2) <= 1).any()) for c in colours) / len(colours)
        for name, colours in wanted.items()
    }

found = {"psi": seen()}
for key, name in (("T", "time"), ("I", "intensity"), ("P", "psi again")):
    pressed[key](shown)
    found[name] = seen()
print(json.dumps(found))
"""


@pytest.mark.slow
def test_the_window_shows_map_trajectory_and_loops_and_keys_change_the_colours(
    finished: Path, screen: dict[str, str]
) -> None:
    program = [sys.executable, "-c", PROGRAM, finished]
    found = subprocess.run(program, env=screen, capture_output=True, text=True, timeout=1200)
    assert found.returncode == 0, found.stderr
    seen = json.loads(found.stdout.splitlines()[-1])
    assert all(picture["trajectory"] == picture["loops"] == 1.0 for picture in seen.values())
    for name, picture in seen.items():
        for value in ("psi", "intensity", "time"):
            assert (picture[value] > 0.7) == (name.split()[0] == value), (name, picture)


def test_an_open_window_ends_when_it_is_told_to(finished: Path, screen: dict[str, str]) -> None:
    program = subprocess.Popen([COMMAND, "view", finished], env=screen, stderr=subprocess.PIPE, text=True)
    end, loaded = time.monotonic() + 600.0, Path(f"/proc/{program.pid}/maps")
    while "libGLX_mesa" not in loaded.read_text():  # which comes with the window
        assert program.poll() is None and time.monotonic() < end
        time.sleep(0.02)
    with pytest.raises(subprocess.TimeoutExpired):
        program.wait(1.0)
    program.send_signal(signal.SIGTERM)
    _, said = program.communicate(timeout=300.0)
    assert program.returncode == 143 and "mqslam: interrupted" in said
