"""A whole run of the endless drive in a process of its own, which says how much memory it took.

usage: python -m bench.measuring.endless_run HOURS OUT, with tests on the path
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from bench.measuring.endless import record_endlessly

from mqslam.commands.run import Job, execute
from mqslam.commands.work import Work
from mqslam.config import Config
from mqslam.execution.local_engine import LocalEngine

_SCANS_PER_HOUR = 14_400
_JOBS = 2


def main() -> None:
    """Runs so many hours with everything written, and prints scans, loops, seconds and the largest memory as JSON."""
    hours, out = float(sys.argv[1]), Path(sys.argv[2])
    config = Config()
    config = config.model_copy(update={"sensor": config.sensor.model_copy(update={"doppler_beta": 0.0})})
    scans = round(hours * _SCANS_PER_HOUR)
    with LocalEngine(_JOBS) as engine:
        job = Job(record_endlessly(scans), None, config, "psi", False, ())
        summary = execute(job, out, Work(engine), resume=False)
    found = {"scans": scans, "loops": summary["factors"]["loop"], "seconds": summary["runtime_s"]["total"]}
    print(json.dumps({**found, "peak_mb": summary["peak_rss_mb"]}))


if __name__ == "__main__":
    main()
