"""The page of the constants that decide a covariance: no row is wrong, and no constant is forgotten."""

from __future__ import annotations

import ast
import importlib.util
import pkgutil
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
ORIGINS, CONSTANTS = (runpy.run_path(str(DOCS / "hooks" / "origins.py"))[name] for name in ("ORIGINS", "CONSTANTS"))

NO_COVARIANCE = {
    ("mqslam.psi.tracking.matching", "_SEARCH_SIGMAS"): "half width of a search",
    ("mqslam.backend.loops.closing", "_SIGMAS"): "half width of a search",
    ("mqslam.backend.sensors.calibration", "TOLD_SIGMAS"): "decides what is told to the user",
    ("mqslam.backend.sensors.calibration", "_COMMON"): "number of parameters",
    ("mqslam.backend.sensors.gyroscope", "_COMMON"): "number of parameters",
    ("mqslam.backend.sensors.gyroscope", "_LARGEST_SCALE_SIGMA"): "decides whether a gyroscope is used",
}
"""Constants whose names look as if they decided a covariance, and what they decide."""


def list_modules() -> list[str]:
    """Returns the modules of the table, and all modules of the packages in which covariances are made."""
    modules = {constant.module for constant in CONSTANTS}
    for name in ("mqslam.psi", "mqslam.backend", "mqslam.frontends", "mqslam.factors"):
        package = importlib.import_module(name)
        modules |= {module.name for module in pkgutil.walk_packages(package.__path__, f"{name}.")}
    return sorted(modules)


def list_constants(module: str) -> list[str]:
    """Returns the names that a module itself assigns at its top level, without those that it imports."""
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None
    names = []
    for statement in ast.parse(Path(spec.origin).read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign | ast.AnnAssign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names += [node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)]
    return names


@pytest.mark.parametrize("constant", CONSTANTS, ids=lambda constant: f"{constant.module}.{constant.name}")
def test_every_row_shows_numbers_and_says_where_they_come_from(constant: Any) -> None:
    numbers = constant.list_numbers()
    assert numbers and np.all(np.isfinite(numbers))
    assert constant.decides.endswith(".")
    assert constant.origin in ORIGINS
    assert constant.on or constant.origin not in ("tuned", "data")


def test_no_constant_is_listed_twice() -> None:
    names = [(constant.module, constant.name) for constant in CONSTANTS]
    assert len(set(names)) == len(names)


def test_no_constant_whose_name_speaks_of_a_covariance_is_forgotten() -> None:
    listed = {(constant.module, constant.name) for constant in CONSTANTS}
    words = ("SIGMA", "FLOOR", "PRIOR", "COMMON")
    telling = {
        (module, name)
        for module in list_modules()
        for name in list_constants(module)
        if name.isupper() and any(word in name for word in words)
    }
    assert telling - listed - NO_COVARIANCE.keys() == set()
    assert NO_COVARIANCE.keys() <= telling - listed  # no reason is left of a constant that is gone


def test_every_standard_deviation_among_the_settings_is_listed() -> None:
    from mqslam.config import Config

    numbers = {
        f"{section}.{name}"
        for section, values in Config()
        for name, value in values
        if ("sigma" in name or name == "blur_m") and value is not None  # null leaves it to the recording
    }
    assert numbers <= {constant.name for constant in CONSTANTS if constant.module == "mqslam.config"}


def test_the_page_on_uncertainty_states_the_counts_of_the_table() -> None:
    text = (DOCS / "explanation" / "uncertainty.md").read_text(encoding="utf-8")
    tuned, unknown = (sum(constant.origin == origin for constant in CONSTANTS) for origin in ("tuned", "not recorded"))
    assert f"of {len(CONSTANTS)} constants, {tuned} are tuned on " in " ".join(text.split())
    assert f"the origin of {unknown} is not recorded" in " ".join(text.split())
