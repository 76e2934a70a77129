"""The page of a diagnosis: the argument in words that fit the numbers, and every figure."""

import base64
import html
import re
from dataclasses import replace

import numpy as np
import pytest
from planted import believed

from sma_bench.cards import card
from sma_bench.diagnose.decision import Decision
from sma_bench.diagnose.facts import explanation
from sma_bench.diagnose.next_experiment import NextExperiment
from sma_bench.report.diagnosis_figures import next_experiment_picture
from sma_bench.report.diagnosis_report import _improved, write_diagnosis_report

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

PROTOCOL = {
    "steps": [
        {"kind": "step", "level": 2.0, "duration": 5.0, "drive": "front"},
        {"kind": "rest", "duration": 10.0},
    ]
}


@pytest.fixture(scope="module")
def page(planted_diagnosis, tmp_path_factory):
    path = write_diagnosis_report(tmp_path_factory.mktemp("report") / "gap", planted_diagnosis)
    return path.parent, path.read_text()


def judged(result, verdict):
    """The same fits with another verdict."""
    first = next((c for c in result.decision.candidates if c.name == verdict), None)
    others = [c for c in result.decision.candidates if c is not first]
    ranked = (replace(first, probability=0.9), *others) if first else tuple(others)
    model = first.fit if first and first.fit else result.model
    return replace(
        result,
        decision=Decision(verdict, (), ranked),
        model=model,
        verdict=verdict,
        cause=(),
        candidates=tuple(map(explanation, ranked)),
    )


def test_the_page_makes_the_argument_in_order_with_every_figure(page, planted_diagnosis):
    folder, text = page
    shown = card(planted_diagnosis)
    assert text.index('class="card"') < text.index("<h2>")
    labels = [label for label, _ in shown.rows if label]
    assert labels == ["cause", "where", "error", "rivals", "next"]
    assert str(planted_diagnosis).startswith(shown.title)
    for made in (planted_diagnosis._repr_html_(), text):
        assert shown.title in html.unescape(made).replace("\u00a0", " ")
    assert re.findall(r"<h2>(.*?)</h2>", text) == [
        "1. Is there a gap beyond the noise?",
        "2. Where is it?",
        "3. Which effect, and how sure?",
        "4. How far does it shrink?",
        "5. What next?",
        "6. What was looked at",
        "Provenance",
    ]
    names = {path.stem.removeprefix("diagnosis_") for path in folder.glob("*.png")}
    maps = {"where", "stages", "candidates", "evidence", "shrinkage"}
    assert names == {"current", "temperature", "deflection"} | maps
    images = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert len(images) == len(names)
    assert all(base64.b64decode(image).startswith(b"\x89PNG") for image in images)
    assert not re.search(r'(?:src|href)="(?!data:)', text)


def test_what_the_geometry_gives_is_believed_to_be_that(planted_diagnosis):
    """Not the 0 that stands in the file for it."""
    name = "composite.deflection_per_strain"
    given = planted_diagnosis.parameters[name]
    file = planted_diagnosis.parameters.replace({name: 0.0})
    rows = {row[0]: row for row in _improved(replace(planted_diagnosis, parameters=file)).rows}
    _, believed, _, _, moved = rows[name]
    assert float(believed) == pytest.approx(given, rel=1e-5) and abs(float(moved)) < 3.0
    assert not any(row[4] in ("+0.0", "-0.0") for row in rows.values())


def test_an_unexplained_gap_shows_the_shape_of_what_is_missing(planted_diagnosis, tmp_path):
    result = judged(planted_diagnosis, "unexplained")
    text = write_diagnosis_report(tmp_path, result).read_text()
    assert "The shape of what is missing" in text
    drawn = {path.stem for path in tmp_path.glob("diagnosis_missing_*.png")}
    assert drawn & {"diagnosis_missing_back_1_temperature", "diagnosis_missing_deflection"}


def test_the_next_experiment_is_drawn_and_explained(planted_diagnosis):
    assert next_experiment_picture(planted_diagnosis, believed()) is None
    proposed = NextExperiment(
        "protocol", "a long rest separates them", ("slack", "residual_strain"), PROTOCOL,
        *(0.25, 0.9, 0.4),
    )
    result = replace(planted_diagnosis, next_experiment=proposed)
    picture = next_experiment_picture(result, believed())
    (ax,) = picture.figure.axes
    highest = max(float(np.max(line.get_ydata())) for line in ax.lines)
    assert highest == pytest.approx(2.0)
    assert "slack, residual_strain" in picture.caption
