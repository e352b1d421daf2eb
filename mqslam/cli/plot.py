"""`mqslam plot`: draws a result for print."""

from __future__ import annotations

from pathlib import Path

from mqslam.cli.options import Options, argument, command, option
from mqslam.cli.terminal import Terminal, echo

_OWN: Options = {
    "result": argument(Path, ..., "OUT", "The folder of a result of run, localise or merge."),
    "out": option(
        Path | None, None, "The picture to write: .pdf, .png or .svg. By default it is OUT/plot.pdf.", "--out", "-o"
    ),
}


@command("result out force quiet verbose", _OWN)
def plot(terminal: Terminal, *, result: Path, out: Path | None, force: bool) -> None:
    """Draw a result as one figure for print.

    The figure shows the path and the map, which is darker where its points are denser; for a localisation, this is the map
    of the earlier run. For a single trajectory it also shows the covariance, and the error if the result holds ground truth.

    Example: mqslam plot result --out map.pdf
    """
    from mqslam.commands.plot import plot as do

    with terminal.open_work() as work:
        written = do(result, out, force=force, work=work)
    if not terminal.quiet:
        echo(str(written))
