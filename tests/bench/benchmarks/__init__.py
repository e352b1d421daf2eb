"""All benchmarks by their names, first those that need nothing but mqslam."""

from bench.benchmarks import (
    audits,
    city,
    costs,
    front_ends,
    maps,
    own_graph,
    places,
    planar,
    ranges,
    real,
    robustness,
    runs,
    sensors,
    uncertainty,
    views,
    workers,
    worlds,
)

_MODULES = (
    *(
        audits,
        city,
        costs,
        front_ends,
        maps,
        own_graph,
        places,
        planar,
        ranges,
        real,
        robustness,
        runs,
        sensors,
        uncertainty,
        views,
    ),
    *(workers, worlds),
)
_KNOWN = {name: benchmark for module in _MODULES for name, benchmark in module.BENCHMARKS.items()}
BENCHMARKS = {name: _KNOWN[name] for name in sorted(_KNOWN, key=lambda name: (_KNOWN[name].data != "simulated", name))}
