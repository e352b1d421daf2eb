"""All benchmarks by their names, first those that need nothing but mqslam."""

from importlib import import_module
from pkgutil import iter_modules

_MODULES = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
_KNOWN = {name: benchmark for module in _MODULES for name, benchmark in module.BENCHMARKS.items()}
BENCHMARKS = {name: _KNOWN[name] for name in sorted(_KNOWN, key=lambda name: (_KNOWN[name].data != "simulated", name))}
