"""The example notebook runs from top to bottom, and lies in the repository with what it showed."""

import ast
import json
from pathlib import Path

import pytest

from sma_bench import compiled

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs" / "tutorials" / "notebook.ipynb"


def code_cells(path: Path) -> list[dict]:
    cells = json.loads(path.read_text())["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def run(path: Path, show) -> dict:
    """Run the cells in one namespace as Jupyter does; `show` gets the value at a cell's end."""
    names: dict = {"__name__": "__main__"}
    for number, cell in enumerate(code_cells(path), start=1):
        where, source = f"{path.name}, code cell {number}", "".join(cell["source"])
        *first, last = ast.parse(source, where).body
        if not isinstance(last, ast.Expr) or source.rstrip().endswith(";"):
            exec(compile(source, where, "exec"), names)
            continue
        exec(compile(ast.Module(first, []), where, "exec"), names)
        show(eval(compile(ast.Expression(last.value), where, "eval"), names))
    return names


def test_notebook_is_committed_as_it_was_run_from_top_to_bottom():
    cells = code_cells(NOTEBOOK)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert {"execute_result", "display_data", "stream"} == {o["output_type"] for o in outputs}
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    assert NOTEBOOK.stat().st_size < 300_000


@pytest.mark.slow
@pytest.mark.skipif(compiled.numba is None, reason="without numba a diagnosis takes minutes")
def test_the_notebook_identifies_names_the_effect_and_draws_two_figures():
    pytest.importorskip("pandas")
    import matplotlib.pyplot as plt

    plt.close("all")
    shown: list = []
    names = run(NOTEBOOK, shown.append)
    tables = [thing for thing in shown if hasattr(thing, "columns")]
    table = next(t for t in tables if t.index.name == "parameter")
    found = table.loc["wire.resistance"]
    true = names["run"].parameters["wire.resistance"]
    assert abs(found["value"] - true) < 4.0 * found["std"]
    assert list(names["record"].signals) in [s for s in shown if isinstance(s, list)]

    assert names["gap"].cause == ("supply_drop",)
    assert any("supply_drop" in t.index for t in tables)
    assert names["gap"].shrinkage["temperature"].fraction > 0.7
    measured = names["arrays"]["wire.temperature"]
    missed = [abs(measured - names[m].temperature[:, 0]).mean() for m in ("before", "after")]
    assert missed[1] < 0.3 * missed[0]

    figures = [plt.figure(number) for number in plt.get_fignums()]
    plt.close("all")
    assert len(figures) == 2
    assert all(axes.lines and axes.get_ylabel() for figure in figures for axes in figure.axes)
