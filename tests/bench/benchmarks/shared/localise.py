"""A drive through the city twin localised in the map of another day, both ways round, and another town refused."""

from __future__ import annotations

from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label
from bench.measuring.commands import is_refused, run
from bench.measuring.localising import measure_cold_starts, measure_localised
from bench.measuring.recordings import simulate_short_city, twin

_RUNS = (("kaist01", 1), ("kaist02", 2))  # run, seed
_OTHER_TOWN = 3  # seed of the simulator's city


def _measure(out: Path) -> list[Row]:
    data = {name: twin(name, "hard", seed) for name, seed in _RUNS}
    results = {name: run(path, out / name) for name, path in data.items()}
    other = simulate_short_city("hard", _OTHER_TOWN)
    rows = []
    for mapped, driven in (("kaist01", "kaist02"), ("kaist02", "kaist01")):
        sources = data[driven], data[mapped], results[mapped]
        cells = measure_localised(*sources, out / f"{driven}-in-{mapped}") | measure_cold_starts(*sources)
        refused = is_refused(other, results[mapped], out / f"other-in-{mapped}")
        rows.append(Row({"drive": f"{driven} in {mapped}", **cells, "refused": float(refused)}))
    return rows


BENCHMARK = Benchmark(
    what="A drive of the hard city twin localised in the map of another day, by radar alone, on one job. Errors are those "
    "against the nearest keyframe of the map. Cold starts have half a minute of the recording.",
    data="twin",
    seeds=(1, 2, _OTHER_TOWN),
    columns=(
        label("drive", "drive"),
        Column("near", "of scans within 5 m of the map, share within 0.3 m and 0.5 deg", "{:.1%}", Goal.HIGH),
        Column("wrong", "scans on the map beyond that", "{:.0f}"),
        Column("outside", "scans on the map 20 m beside it", "{:.0f}"),
        Column("error_m", "95 % of errors [m]", "{:.3f}", Goal.LOW),
        Column("error_deg", "95 % of errors [deg]", "{:.3f}", Goal.LOW),
        Column("nees", "NEES/3", "{:.2f}", Goal.ONE),
        Column("real_time", "times real time", "{:.1f}"),
        Column("peak_mb", "peak memory [MB]", "{:.0f}"),
        Column("starts", "cold starts", "{:.0f}"),
        Column("found", "of them found", "{:.1%}"),
        Column("wrong_starts", "of them wrong", "{:.0f}"),
        Column("start_s", "slowest cold start [s]", "{:.1f}"),
        Column("refused", "another town refused", "{:.0f}"),
    ),
    measure=_measure,
    bounds=(
        Bound("near", {}, least=0.95),
        Bound("outside", {}, most=0.0),
        Bound("nees", {}, least=0.6, most=1.6),
        Bound("real_time", {}, least=5.0),
        Bound("wrong_starts", {}, most=0.0),
        Bound("start_s", {}, most=10.0),
        Bound("refused", {}, least=1.0),
    ),
)
