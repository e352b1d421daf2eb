"""The batch: runs many recordings and reports over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mqslam.commands.batches.batch_plan import read_plan
from mqslam.commands.batches.batch_schedule import AGAIN, run_all
from mqslam.commands.result import Result
from mqslam.commands.work import QUIET, Work
from mqslam.errors import ClusterError
from mqslam.execution.guards.locks import lock_output
from mqslam.report.batch_page import write_batch_pages
from mqslam.results.batch_results import Order, check_batch, summarise, write_batch
from mqslam.results.summary_files import add_warnings


def run_batch(plan: Path | str, out: Path | str, *, force: bool = False, work: Work = QUIET) -> Result:
    """Runs many recordings and reports over all of them; if a run fails, the report says why and the others go on.

    Args:
        plan: the YAML file that lists the runs.
        out: folder of the results, one in it per run; what is finished there is kept.
        force: whether results that are there are replaced.
        work: where the work is done, and who is told about it.

    Returns:
        What the batch has left at `out`.

    Raises:
        ConfigError: the file holds a mistake.
        OutputError: the folder holds other results or cannot be written.
        ClusterError: the cluster is lost; the same call continues the batch.
    """
    plan, out = Path(plan), Path(out)
    orders, text = read_plan(plan)
    with lock_output(out.absolute()):
        return _run_all(plan, orders, text, out, force=force, work=work)


def _run_all(plan: Path, orders: Sequence[Order], text: str, out: Path, *, force: bool, work: Work) -> Result:
    """Does the runs of a plan, as `run_batch` says, in a folder that nobody else writes."""
    check_batch(out, force=force)
    try:
        outcomes = run_all(orders, out.absolute(), work.engine, work.progress, force=force)
    except ClusterError as error:
        raise ClusterError(error.message, *error.remedies, AGAIN) from error
    except BaseException as error:
        error.add_note(AGAIN)
        raise
    summary = summarise(orders, outcomes)
    write_batch(out, summary)
    add_warnings(out / "batch.json", summary, write_batch_pages(out, plan.stem, summary, text))
    return Result(out, summary)
