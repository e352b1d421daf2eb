"""The paper's Table I: motion of three constant drives by the published score and by our estimator."""

from __future__ import annotations

import os
from pathlib import Path

from bench.benchmark import Benchmark, Bound, Column, Goal, Row, label

from mqslam.psi.published.paper import OURS, PAPER_LARGEST, compute_table1

_SEEDS = 10


def _measure(out: Path) -> list[Row]:
    rows = [
        Row(
            {
                "case": "v {:g} m/s, omega {:g} rad/s".format(*row.case),
                "method": row.method,
                "mean_v": float(row.mean[0]),
                "mean_omega": float(row.mean[1]),
                "rms_v": float(row.rms[0]),
                "rms_omega": float(row.rms[1]),
            },
            judged=row.method == OURS,
        )
        for row in compute_table1(_SEEDS, jobs=os.cpu_count() or 1)
    ]
    paper = {"case": "all", "method": "the paper's largest error", "rms_v": PAPER_LARGEST[0], "rms_omega": PAPER_LARGEST[1]}
    return [*rows, Row(paper, judged=False)]


BENCHMARK = Benchmark(
    what="The paper's sensor in simulated yards, with windows of four scans.",
    data="simulated",
    seeds=tuple(range(_SEEDS)),
    columns=(
        label("case", "case"),
        label("method", "method"),
        Column("mean_v", "mean v [m/s]", "{:.4f}"),
        Column("mean_omega", "omega [rad/s]", "{:.4f}"),
        Column("rms_v", "RMS error of v [m/s]", "{:.4f}", Goal.LOW),
        Column("rms_omega", "of omega [rad/s]", "{:.4f}", Goal.LOW),
    ),
    measure=_measure,
    bounds=(Bound("rms_v", {"method": OURS}, most=0.01), Bound("rms_omega", {"method": OURS}, most=0.002)),
)
