"""Imports Python files of a user's own, which define a front end or a test of a map."""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType


def import_file(path: Path, what: str) -> ModuleType:
    """Imports a Python file that is in no package, and returns its module.

    Args:
        path: the file.
        what: what the file defines, which is part of the module's name: `front_end` or `map_test`.
    """
    spec = spec_from_file_location(f"mqslam_{what}_{path.stem}", path)
    assert spec is not None and spec.loader is not None, path
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
