"""The runs of a batch, each on its own: what fails is said, and the others go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mqslam.commands.run import Job, execute, finished, open_job
from mqslam.commands.work import Work
from mqslam.errors import MqslamError, said
from mqslam.execution.engine import DIED, Engine, LocalEngine
from mqslam.execution.folders import check_free
from mqslam.execution.progress import Progress
from mqslam.results.batch_results import Order, Outcome

AGAIN = "the same command goes on with it"


@dataclass(frozen=True, slots=True)
class Terms:
    """What holds for every run of a batch.

    Args:
        out: folder of the batch.
        jobs: processes or threads that a run may use.
        force: whether results that are there are replaced.
    """

    out: Path
    jobs: int
    force: bool


def run_all(orders: Sequence[Order], out: Path, engine: Engine, progress: Progress, *, force: bool) -> list[Outcome]:
    """Do the runs, or find them done.

    Args:
        orders: the runs.
        out: folder of the batch, an absolute path.
        engine: where they run.
        progress: called as they are done.
        force: whether results that are there are replaced.

    Raises:
        ClusterError: the cluster can do no more of them.
    """
    terms = Terms(out, engine.jobs, force)
    before = engine.map(_kept, terms, orders)
    missing = [order for order, kept in zip(orders, before, strict=True) if kept is None]

    def done(number: int, outcome: Outcome | None) -> None:
        progress("runs", len(orders) - len(missing) + number, len(orders))

    ran = iter(engine.apart(run_one, terms, missing, done))
    return [
        _seen(out / order.name, kept or next(ran) or Outcome(failure=DIED))
        for order, kept in zip(orders, before, strict=True)
    ]


def run_one(terms: Terms, order: Order) -> Outcome:
    """Do a run in this process; whatever stops it is said."""
    out = terms.out / order.name
    try:
        kept = _kept(terms, order)  # done by a worker that died before it could say so
        if kept is not None:
            return kept
        check_free(out, force=terms.force, resume=True, recording=order.data)
        job = _job(order)
        summary = execute(job, out, Work(LocalEngine(terms.jobs)), resume=not terms.force, how=AGAIN)
        return Outcome(summary)
    except Exception as error:  # a front end may be anyone's code, and the others are to go on
        return Outcome(failure=said(error))


def _kept(terms: Terms, order: Order) -> Outcome | None:
    """A run that was finished before, of the same recording and settings."""
    out = terms.out / order.name
    if terms.force or not (out / "summary.json").exists():
        return None
    try:
        summary = finished(out, _job(order).key)
    except MqslamError:
        return None  # `run_one` says why
    return None if summary is None else Outcome(summary, kept=True)


def _job(order: Order) -> Job:
    return open_job(order.data, order.settings, order.frontend, order.odometry)


def _seen(out: Path, outcome: Outcome) -> Outcome:
    """The same, if what it left can be seen from here."""
    if outcome.summary is None or (out / "summary.json").is_file():
        return outcome
    return Outcome(failure=f"{out}: is not there on this machine; choose an output folder that all machines share")
