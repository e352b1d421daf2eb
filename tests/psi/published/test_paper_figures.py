"""Figures 2 and 3: a motion that is nearer to the truth has the lower score, and the files are whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.commands import mqslam, read_contents

from mqslam.psi.published.paper import (
    ALGORITHM_1,
    CASES,
    CHARGED,
    PAPER,
    VARIANTS,
    Rendering,
    compute_figure2,
    render_figure2,
    render_figure3,
)


def test_scores_fall_from_bad_to_better_to_good() -> None:
    for seed in (1, 2):
        bad, better, good = render_figure2(seed)
        assert bad.psi > better.psi > good.psi
        assert len(bad.points) == len(good.points) and set(good.scan) == {0, 1, 2, 3}


def test_the_charged_score_has_the_papers_order_and_algorithm_1_its_reverse() -> None:
    scores = compute_figure2()
    assert tuple(scores) == (PAPER, *VARIANTS)
    for name in (PAPER, CHARGED):
        assert scores[name] == sorted(scores[name], reverse=True)
    assert scores[ALGORITHM_1] == sorted(scores[ALGORITHM_1])


def test_compensation_lowers_the_score_of_every_case_to_less_than_half() -> None:
    pairs = render_figure3()
    assert len(pairs) == len(CASES)
    for (before, after), case in zip(pairs, CASES, strict=True):
        assert after.psi < 0.5 * before.psi
        np.testing.assert_array_equal(before.motion, 0.0)
        np.testing.assert_allclose(after.motion, case, atol=0.02)


@pytest.mark.slow
def test_the_command_writes_both_figures_and_says_their_scores(tmp_path: Path) -> None:
    out = tmp_path / "figures"
    out.mkdir()
    (out / "figure2.png").write_text("old")
    shown = mqslam("paper", "figures", "--out", out, "--force")
    assert (shown.code, shown.err) == (0, "")
    assert sorted(read_contents(out)) == ["figure2.png", "figure3.png"]
    for name in read_contents(out):
        with Image.open(out / name) as image:
            assert image.format == "PNG" and min(image.size) > 600
            assert np.asarray(image.convert("L")).std() > 5.0
    scores = "psi " + " > ".join(f"{shown.psi:.0f}" for shown in render_figure2())
    assert f"{out / 'figure2.png'}: {scores}\n" in shown.out


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_figures_are_written_in_other_forms_to_the_same_bytes(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps = [Rendering(name, np.zeros(2), np.ones((4, 2)), np.arange(4), 1.0) for name in "abc"]
    monkeypatch.setattr("mqslam.psi.published.paper.render_figure2", lambda _: maps)
    monkeypatch.setattr("mqslam.psi.published.paper.render_figure3", lambda _: [(maps[0], maps[1])] * 3)
    for name in ("one", "two"):
        assert mqslam("paper", "figures", "--out", tmp_path / name, "--suffix", suffix).code == 0
    written = read_contents(tmp_path / "one")
    assert sorted(written) == [f"figure2{suffix}", f"figure3{suffix}"] and written == read_contents(tmp_path / "two")
    assert all(content.startswith(b"%PDF" if suffix == ".pdf" else b"<?xml") for content in written.values())
    assert mqslam("paper", "figures", "--out", tmp_path / "three", "--suffix", ".bmp").code == 2


def test_a_folder_with_content_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("kept")
    before = read_contents(tmp_path)
    shown = mqslam("paper", "figures", "--out", tmp_path)
    assert shown.code == 2 and shown.err.startswith(f"mqslam: error: {tmp_path}: exists already")
    assert read_contents(tmp_path) == before
