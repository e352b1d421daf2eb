"""The real sample without odometry: errors against its ground truth by range bin and Doppler shift."""

from __future__ import annotations

from pathlib import Path

from common import OXFORD, Claim, score, shared, table
from common import run as mqslam_run

_BINS_M = (0.0432, 0.0438)  # as published; the default
_DOPPLERS = (0.0, 0.049, None)  # [s]; None: measured by psi, the default


def run(out: Path) -> list[Claim]:
    data = shared(OXFORD)
    rows: list[list[str | float]] = []
    for bin_m in _BINS_M:
        for doppler in _DOPPLERS:
            settings = out / "doppler.yaml"
            settings.write_text(f"sensor: {{doppler_beta: {'null' if doppler is None else doppler}}}\n", encoding="utf-8")
            options = ["--range-resolution", str(bin_m), "--config", str(settings)]
            errors = _measured(data, out, *options)
            rows.append([f"{bin_m}", _name(doppler, out / "oxford"), *_errors(errors)])
    default = _measured(data, out)
    kiss = _measured(data, out, "--frontend", "kiss_icp")
    rows += [["default", "default", *_errors(default)], ["KISS-ICP front end", "", *_errors(kiss)]]
    table(["range bin [m]", "Doppler [s]", "v bias [m/s]", "v RMS [m/s]", "omega RMS [rad/s]"], rows)
    return [
        Claim("rpe_w_rms [rad/s]", default["rpe_w_rms"], most=0.006),
        Claim("rpe_v_rms [m/s]", default["rpe_v_rms"], most=0.30),
        Claim("|rpe_v_bias| [m/s]", abs(default["rpe_v_bias"]), most=0.12),
    ]


def _measured(data: Path, out: Path, *options: str) -> dict[str, float]:
    mqslam_run(data, out / "oxford", *options)
    return score(out / "oxford" / "trajectory.tum", data / "gt" / "radar_odometry.csv")


def _name(doppler: float | None, result: Path) -> str:
    """Returns the Doppler shift in words, with the value that psi measured where it did."""
    if doppler is not None:
        return f"{doppler:g}"
    import yaml

    used = yaml.safe_load((result / "config.yaml").read_text(encoding="utf-8"))["sensor"]["doppler_beta"]
    return f"measured: {used:g}"


def _errors(errors: dict[str, float]) -> list[float]:
    return [errors["rpe_v_bias"], errors["rpe_v_rms"], errors["rpe_w_rms"]]
