"""The page of a batch tells its runs in words, and in numbers that unfold."""

from __future__ import annotations

import re
from pathlib import Path

from support.pages import text_of


def test_every_run_is_told_in_words(pages: dict[str, Path]) -> None:
    text = text_of(pages["batch"])
    good = "no test found a fault\n1\n421 m in 1 min 0 s, 3 loops closed\n"
    assert f"{good}26 mm off (ATE, RMSE), drift of 0.0319 %" in text
    assert "33 of 40 windows are <torn>\n–\n2.50 km in 1 min 0 s, no loop closed\nno ground truth" in text
    assert "gone\nfailed: polar scan 7" in text
    assert "bad and alone: the <clock> drifts" in text and "good: " not in text
    assert "number\nwhat\nruns\n1\non <assumed> range bins rests its scale\ngood and alone" in text
    assert text.count("on <assumed> range bins") == text.count("the <clock> drifts") == 1
    assert "1\nruns of which not all was judged" in text and "ψ" not in text


def test_the_numbers_unfold_and_leave_out_runs_that_failed(pages: dict[str, Path]) -> None:
    page = (pages["batch"] / "report.html").read_text(encoding="utf-8")
    folded = re.search(r"<details class=\"card\"><summary>The same in numbers</summary>(.*?)</details>", page, re.DOTALL)
    assert folded is not None and folded[1].count('scope="row"') == 3 and "gone" not in folded[1]
