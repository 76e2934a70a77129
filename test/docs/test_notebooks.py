"""The example notebook runs from top to bottom, and lies in the repository with what it showed."""

import json
from pathlib import Path

import pytest

import sma_bench
from sma_bench import compiled

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "tutorials" / "notebook.ipynb"
CELLS = [c for c in json.loads(NOTEBOOK.read_text())["cells"] if c["cell_type"] == "code"]


def test_notebook_is_committed_as_it_was_run_from_top_to_bottom():
    assert [cell["execution_count"] for cell in CELLS] == list(range(1, len(CELLS) + 1))
    outputs = [output for cell in CELLS for output in cell["outputs"]]
    assert {"execute_result", "display_data", "stream"} == {o["output_type"] for o in outputs}
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    assert NOTEBOOK.stat().st_size < 300_000


@pytest.mark.slow
@pytest.mark.skipif(compiled.numba is None, reason="without numba a diagnosis takes minutes")
def test_the_notebook_identifies_names_the_effect_and_draws_two_figures():
    pytest.importorskip("pandas")
    import matplotlib.pyplot as plt

    plt.close("all")
    names = {"__name__": "__main__"}
    for number, cell in enumerate(CELLS, start=1):
        exec(compile("".join(cell["source"]), f"code cell {number}", "exec"), names)
    found = sma_bench.to_frame(names["found"]).loc["wire.resistance"]
    assert abs(found["value"] - names["run"].parameters["wire.resistance"]) < 4.0 * found["std"]
    assert list(names["record"].signals) == ["wire.voltage", "wire.current", "wire.temperature"]
    assert names["gap"].cause == ("supply_drop",)
    assert "supply_drop" in sma_bench.to_frame(names["gap"]).index
    assert names["gap"].shrinkage["temperature"].fraction > 0.7
    measured = names["arrays"]["wire.temperature"]
    missed = [abs(measured - names[m].temperature[:, 0]).mean() for m in ("before", "after")]
    assert missed[1] < 0.3 * missed[0]

    figures = [plt.figure(number) for number in plt.get_fignums()]
    plt.close("all")
    assert len(figures) == 2
    assert all(axes.lines and axes.get_ylabel() for figure in figures for axes in figure.axes)
