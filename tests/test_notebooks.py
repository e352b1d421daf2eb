"""Notebooks run top to bottom, draw their figures and find what their text says."""

from __future__ import annotations

import ast
import functools
import inspect
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
FINDINGS = {
    "01_psi_by_hand": """
        assert abs(minimum.theta - truth).max() < 0.03 and minimum.status == "converged"
        assert abs(lowest["as printed"] - truth)[1] > 0.5
        assert (abs(lowest["unmatched points charged"] - truth) < [0.5, 0.05]).all()
        assert np.hypot(*whiten(minimum)) < 3.0
        assert 1.4 < np.mean((errors**2).sum(axis=1)) < 3.0
        """,
    "02_full_run": """
        assert evaluate(run.odometry, truth).ate_rmse_m > 5.0 and evaluate(run.optimised, truth).ate_rmse_m < 0.15
        assert len(run.loops) > 5 and residuals(run.odometry).min() > 1.0 and residuals(run.optimised).max() < 0.1
        assert run.map_optimised.psi.mean() < 0.6 * run.map_odometry.psi.mean()
        """,
    "03_audit_and_compare": """
        assert audits["true"][1].verdict.status == "pass" and audits["bent"][1].verdict.status == "fail"
        torn = [window for window in audits["bent"][1].windows if window.torn]
        assert len(torn) > 4 and all(window.t1 > 20.0 and window.t0 < 30.0 for window in torn)
        assert 1.5 < np.median(inflations("true")) < 4.5
        errors = {label: evaluate(row.trajectory, truth) for label, row in rows.items()}
        assert 2.0 * errors["ψ"].rpe_v_rms < errors["KISS-ICP"].rpe_v_rms
        """,
    "04_own_graph": """
        assert len(pairs) > 5 and sigmas["radar"][0] < 0.01 and sigmas["radar"].max() > 0.25
        assert sigmas["radar, GNSS"].max() < 0.4 and sigmas["radar, GNSS, loops"].max() < 0.25
        assert np.sqrt(np.mean(errors["radar, GNSS, loops"] ** 2)) < 0.25
        for name in optima: assert 0.1 < np.mean((errors[name] / sigmas[name]) ** 2) < 3.0
        assert np.std(heights) < 0.5 * np.std(ups)
        """,
}


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_top_to_bottom_and_finds_what_it_says(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    lines = [line.strip() for line in FINDINGS[path.stem].strip().splitlines()]
    notebook.cells.append(nbformat.v4.new_code_cell("\n".join(lines)))
    patience = {"timeout": 1800, "startup_timeout": 600}  # [s]; they only end what hangs
    NotebookClient(notebook, kernel_name="python3", resources={"metadata": {"path": path.parent}}, **patience).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 3
    said = [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    lines = [line for text in said for line in text.splitlines()]
    assert not [line for line in lines if "findfont" not in line and "font cache" not in line]  # the machine's fonts


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_a_notebook_imports_exists_and_takes_the_arguments_that_it_is_given(path: Path) -> None:
    cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    code = ast.parse("\n".join(cells))
    imports = [node for node in code.body if isinstance(node, ast.Import | ast.ImportFrom)]
    names: dict[str, Any] = {}
    exec(compile(ast.Module(imports, []), path.name, "exec"), names)
    checked = 0
    for call in (node for node in ast.walk(code) if isinstance(node, ast.Call)):
        path_of_name = ast.unparse(call.func).split(".")
        starred = [value for value in call.args if isinstance(value, ast.Starred)]
        if path_of_name[0] not in names or not all(map(str.isidentifier, path_of_name)) or starred:
            continue
        called = functools.reduce(getattr, path_of_name[1:], names[path_of_name[0]])
        keywords = {keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}
        if getattr(called, "__module__", "").startswith("mqslam") and len(keywords) == len(call.keywords):
            inspect.signature(called).bind(*call.args, **keywords)
            checked += 1
    assert checked > 3


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_carries_its_outputs(path: Path) -> None:
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert sum("image/png" in output.get("data", {}) for cell in cells for output in cell.outputs) >= 3
    assert path.stat().st_size < 2_000_000
