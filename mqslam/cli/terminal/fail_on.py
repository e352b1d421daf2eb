"""--fail-on: makes the verdict on a map the exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from mqslam.auditing.verdict import VerdictStatus

FailOn = Annotated[
    Literal["warn", "fail"] | None,
    typer.Option(
        help="Exit with 1 if the verdict is this or worse (in an audit, on the trajectory as it is given), and with 3 if "
        "the map could not be judged."
    ),
]


def choose_exit_code(status: VerdictStatus, fail_on: Literal["warn", "fail"]) -> int:
    """Returns the exit code of --fail-on; a map that could not be judged has a code of its own."""
    from mqslam.auditing.verdict import VerdictStatus

    if status is VerdictStatus.NOT_JUDGED:
        return 3
    return int(status is VerdictStatus.FAIL or (status is VerdictStatus.WARN and fail_on == "warn"))
