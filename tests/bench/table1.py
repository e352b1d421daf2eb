"""The paper's Table I over 20 seeds."""

from __future__ import annotations

import os
from pathlib import Path

from common import Claim

from mqslam.psi.published.table1 import OURS, compute_table1, format_table

_SEEDS = 20


def run(out: Path) -> list[Claim]:
    rows = compute_table1(_SEEDS, jobs=os.cpu_count() or 1)
    print(format_table(rows))
    claims = []
    for row in rows:
        if row.method == OURS:
            case = "({:g}, {:g})".format(*row.case)
            claims.append(Claim(f"{case}: RMS error of v [m/s]", float(row.rms[0]), most=0.01))
            claims.append(Claim(f"{case}: RMS error of omega [rad/s]", float(row.rms[1]), most=0.002))
    return claims
