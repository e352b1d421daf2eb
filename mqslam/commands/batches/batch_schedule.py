"""The runs of a batch, each on its own: if one fails, its error is kept and the others go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mqslam.commands.inputs.opening import Inputs
from mqslam.commands.run import Job, execute, find_finished, open_job
from mqslam.commands.work import Work
from mqslam.core.engine import Engine
from mqslam.errors import MqslamError, describe_error, raise_interrupt
from mqslam.execution.folders import claim_folder
from mqslam.execution.local_engine import DIED, LocalEngine
from mqslam.execution.progress import Progress
from mqslam.results.batch_results import Order, RunOutcome

AGAIN = "the same command continues the batch"


@dataclass(frozen=True, slots=True)
class Terms:
    """The terms that all runs of a batch share.

    Args:
        out: folder of the batch.
        jobs: processes that a run may use.
        force: whether results that are there are replaced.
    """

    out: Path
    jobs: int
    force: bool


def run_all(orders: Sequence[Order], out: Path, engine: Engine, progress: Progress, *, force: bool) -> list[RunOutcome]:
    """Does the runs that are not finished yet, and returns the outcome of each run.

    Args:
        orders: the runs.
        out: folder of the batch, an absolute path.
        engine: where they run.
        progress: called as runs are done.
        force: whether results that are there are replaced.

    Raises:
        ClusterError: the cluster is lost.
    """
    terms = Terms(out, engine.jobs, force)
    before = [_find_kept(terms, order) for order in orders]
    missing = [order for order, kept in zip(orders, before, strict=True) if kept is None]

    def done(number: int, outcome: RunOutcome | None) -> None:
        progress("runs", len(orders) - len(missing) + number, len(orders))

    ran = iter(engine.map_apart(run_one, terms, missing, done))
    return [
        _check_outcome(out / order.name, kept or next(ran) or RunOutcome(failure=DIED))
        for order, kept in zip(orders, before, strict=True)
    ]


def run_one(terms: Terms, order: Order) -> RunOutcome:
    """Does a run in this process and returns its outcome, which is the error's text if it fails."""
    out = terms.out / order.name
    try:
        kept = _find_kept(terms, order)  # a worker may have done it and died before it could report it
        if kept is not None:
            return kept
        with claim_folder(out, force=terms.force, resume=True, sources=[order.data]):
            job = _open_order(order)
            with LocalEngine(terms.jobs) as engine:
                summary = execute(job, out, Work(engine), resume=not terms.force, how=AGAIN)
        return RunOutcome(summary)
    except Exception as error:  # a front end may be anyone's code, and the others are to go on
        raise_interrupt(error)
        return RunOutcome(failure=describe_error(error))


def _find_kept(terms: Terms, order: Order) -> RunOutcome | None:
    """Returns the outcome of the same run if it was finished before, or None."""
    out = terms.out / order.name
    if terms.force or not (out / "summary.json").exists():
        return None
    try:
        summary = find_finished(out, _open_order(order).key)
    except MqslamError:
        return None  # `run_one` fails in the same way and reports why
    return None if summary is None else RunOutcome(summary, kept=True)


def _open_order(order: Order) -> Job:
    """Opens the recording of a run.

    Raises:
        MqslamError: the recording, its odometry, its sensors or its front end cannot be used.
    """
    inputs = Inputs(order.odometry, order.imu, order.gnss, order.extrinsics, order.frame)
    return open_job(order.data, order.settings, order.frontend, inputs)


def _check_outcome(out: Path, outcome: RunOutcome) -> RunOutcome:
    """Returns an outcome, or a failure if its results cannot be seen from this machine."""
    if outcome.summary is None or (out / "summary.json").is_file():
        return outcome
    return RunOutcome(failure=f"{out}: does not exist on this machine; choose an output folder that all machines share")
