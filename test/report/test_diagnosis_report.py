"""The page of a diagnosis: sentences that agree with the numbers, and every figure."""

import html
import re
from dataclasses import replace

import pytest

from sma_bench.diagnose.left_over import missed
from sma_bench.report.plots import missing_pictures
from sma_bench.report.reports import improvements, write_diagnosis_report
from sma_bench.results import card

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

@pytest.fixture(scope="module")
def page(planted_diagnosis, tmp_path_factory):
    path = write_diagnosis_report(tmp_path_factory.mktemp("report") / "gap", planted_diagnosis)
    return path.parent, path.read_text()


def judged(result, verdict):
    """The same result with another verdict."""
    ranked = sorted(result.candidates, key=lambda c: c.name != verdict)
    ranked[0] = replace(ranked[0], probability=0.9)
    return replace(result, verdict=verdict, cause=(), candidates=tuple(ranked))


def test_the_page_makes_the_argument_in_order_with_every_figure(page, planted_diagnosis):
    folder, text = page
    shown = card(planted_diagnosis)
    assert text.index('class="card"') < text.index("<h2>")
    labels = [label for label, _ in shown.rows if label]
    assert labels == ["cause", "where", "error", "rivals", "next"]
    assert str(planted_diagnosis).startswith(shown.title)
    for made in (planted_diagnosis._repr_html_(), text):
        assert shown.title in html.unescape(made)
    titles = [title.rpartition(". ")[2] for title in re.findall(r"<h2>(.*?)</h2>", text)]
    assert titles[:2] == ["Is there a gap beyond the noise?", "Where is it?"]
    assert titles[2:4] == ["Which effect, and how sure?", "How far does it shrink?"]
    assert titles[4:] == ["What next?", "Which data were used?", "Provenance"]
    names = {path.stem.removeprefix("diagnosis_") for path in folder.glob("*.png")}
    maps = {"where", "evidence"}
    assert names == {"current", "temperature", "deflection"} | maps
    assert text.count('src="data:image/png;base64,iVBOR') == len(names)


def test_a_value_that_follows_from_the_geometry_is_shown_instead_of_0(planted_diagnosis):
    """In the file, 0 means: by the geometry."""
    name = "composite.deflection_per_strain"
    given = planted_diagnosis.parameters[name]
    file = planted_diagnosis.parameters.replace({name: 0.0})
    rows = {row[0]: row for row in improvements(replace(planted_diagnosis, parameters=file)).rows}
    _, stated, _, _, moved = rows[name]
    assert float(stated) == pytest.approx(given, rel=1e-5) and abs(float(moved)) < 3.0
    assert not any(row[4] in ("+0.0", "-0.0") for row in rows.values())


@pytest.mark.usefixtures("undrawn")
def test_an_unexplained_gap_shows_its_residual(planted_diagnosis, tmp_path):
    # The residual is due to heat between the sides; a sensor error may look similar.
    inputs = planted_diagnosis.search.inputs
    assert inputs["thermal"].gain > 5.0 and "thermal" in list(inputs)[:2]
    missing = missed(planted_diagnosis.search.recalibrated, "thermal", inputs["thermal"])
    result = replace(judged(planted_diagnosis, "unexplained"), missed=missing)
    pictures = missing_pictures(result)
    lines = [line.get_label() for p in pictures for line in p.figure.axes[0].lines]
    assert "unknown input to the thermal stage" in lines
    text = write_diagnosis_report(tmp_path, result).read_text()
    assert "What no effect explains" in text and "misses the heat most" in text
    drawn = {path.stem for path in tmp_path.glob("diagnosis_missing_*.png")}
    assert drawn & {"diagnosis_missing_back_1_temperature", "diagnosis_missing_deflection"}
