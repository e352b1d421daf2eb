"""Imports Python files in which a user defines a front end or a test of a map, and names them in their errors."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Final

from mqslam.errors import MqslamError, describe_error, raise_interrupt

_log = logging.getLogger(__name__)
NO_IMPORT: Final = "cannot be imported ({})"
STOPPED: Final = "stopped with {}"


def import_file(path: Path, what: str) -> ModuleType:
    """Imports a Python file that belongs to no package, and returns its module.

    Args:
        path: the file.
        what: kind of object that the file defines, `front_end` or `map_test`; it becomes part of the module's name.

    Raises:
        Exception: any error of the file itself, such as a SyntaxError; call this function inside of `blame`.
    """
    spec = spec_from_file_location(f"mqslam_{what}_{path.stem}", path)
    assert spec is not None and spec.loader is not None, path
    module = sys.modules[spec.name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@contextmanager
def blame(owner: str, happened: str, kind: type[MqslamError], remedy: str = "") -> Iterator[None]:
    """Turns an unexpected error of the block, which runs code from outside of mqslam, into an error that names this code.

    A MqslamError is passed on unchanged, and so is a MemoryError, since the code that it stops is seldom at fault.

    Args:
        owner: name of the code for the message, such as "front end mine.py".
        happened: text for the message: `NO_IMPORT` while the code is imported, `STOPPED` while it runs.
        kind: class of the error that is raised.
        remedy: advice to the user, with which the message ends; "" if the text of the unexpected error is enough.

    Raises:
        MqslamError: the block raised an unexpected error; this error is of the class `kind`.
    """
    try:
        yield
    except (MqslamError, MemoryError):
        raise
    except Exception as error:
        raise_interrupt(error)
        _log.info("%s: %s", owner, happened.format("an error"), exc_info=error)
        raise kind(f"{owner}: {happened.format(describe_error(error))}", remedy) from error
