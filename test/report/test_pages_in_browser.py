"""The reports in a real browser: nothing is too wide or too faint, no error on the console."""

import copy
import json

import numpy as np
import pytest
from browser_page import DESKTOP, PHONE, opened
from test_cards import IDENTIFIED

from sma_bench.cli import main
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.report.page import Section, Table, write_report
from sma_bench.report.reports import write_diagnosis_report

WORD = "a_name_without_any_place_to_break_it_" * 4
WIRES = ["front_1", "front_2", "back_1", "back_2"]
SENTENCE = "a cell that says a whole sentence and needs more room than a name does"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Pages by name: of a record and a result, and one with very wide contents."""
    folder = tmp_path_factory.mktemp("pages")
    time = np.arange(0.0, 20.0, 0.01)
    signals = [
        Signal(f"{wire}.{name}", unit, time, level * (1.0 + 0.1 * np.sin(time + k)))
        for k, wire in enumerate(WIRES)
        for name, unit, level in (("voltage", "V", 2.0), ("current", "A", 0.7))
    ]
    write_record(folder / "bag", signals, markers=[(1.0, "hold"), (9.0, "rest")])
    found = copy.deepcopy(IDENTIFIED) | {"warnings": [WORD]}
    found["parameters"]["wire.resistance"]["method"] = SENTENCE
    found["experiments"][0]["source"] = WORD
    (folder / "identified.json").write_text(json.dumps(found))
    records = [str(folder / name) for name in ("bag", "identified.json")]
    assert main(["report", *records, "--out", str(folder / "record")]) == 0
    table = Table([WORD, *"abcdefgh"], [[SENTENCE, WORD, *["-1.2345e-07"] * 7]], frozenset({2}))
    write_report(folder / "wide", WORD, WORD, [Section(WORD, [WORD], [WORD], [table])])
    return {name: folder / name / "index.html" for name in ("record", "wide")}


LINES_OF_NUMBERS = """[...document.querySelectorAll('td.number:not(:empty)')].map((cell) => {
    const range = document.createRange(); range.selectNodeContents(cell);
    return new Set([...range.getClientRects()].map((box) => box.top)).size; })"""
WIDTH = "document.querySelector('figure:not(.drawn) img').getBoundingClientRect().width"
SCROLLED = """() => {
    const box = document.querySelector('figure:not(.drawn) .wide'); box.scrollLeft = 100;
    return box.scrollLeft; }"""


@pytest.mark.parametrize("name", ["record", "wide"])
def test_a_report_fits_and_can_be_read(browser, pages, name):
    url = pages[name].as_uri()
    schemes = ("light", "dark") if name == "record" else ("dark", "light")
    with opened(browser, url, DESKTOP, schemes[0]) as shown:
        assert [*shown.complaints, *shown.too_wide, *shown.faint] == []
    with opened(browser, url, PHONE, schemes[1]) as shown:
        assert [*shown.complaints, *shown.too_wide, *shown.faint] == []
        assert set(shown.page.evaluate(LINES_OF_NUMBERS)) == {1}
        if name == "record":  # figures keep their size and scroll on their own
            assert shown.page.evaluate(WIDTH) >= 600
            assert shown.page.evaluate(SCROLLED) == 100


@pytest.mark.slow
def test_a_diagnosis_fits_a_phone_and_can_be_read(browser, planted_diagnosis, tmp_path):
    page = write_diagnosis_report(tmp_path, planted_diagnosis)
    with opened(browser, page.as_uri(), PHONE, "dark") as shown:
        assert [*shown.complaints, *shown.too_wide, *shown.faint] == []


VALUES = "[...document.querySelectorAll('.view .u-value')].map((value) => value.textContent)"
DRAWN = """(() => {
    const inked = (canvas) => canvas.width > 0 && canvas.height > 0 && canvas.getContext('2d')
        .getImageData(0, 0, canvas.width, canvas.height).data.some((byte) => byte > 0);
    const all = [...document.querySelectorAll('.view canvas')];
    return all.length === 2 && all.every(inked); })()"""


def place(shown, share):
    """Position on the page of a share of the time axis of the first figure."""
    x, y, width = shown.page.evaluate("""() => {
        const plot = document.querySelector('.view .u-over');
        plot.scrollIntoView({ block: 'center' });
        const { x, y, width } = plot.getBoundingClientRect();
        return [x, y, width]; }""")
    return x + share * width, y + 40


def time_shown(shown):
    """Time in s under the pointer, from the legend, which uPlot updates with the next frame."""
    shown.until(f"({VALUES})[0] !== ''")
    return float(shown.page.evaluate(VALUES)[0])


def test_figures_over_time_show_the_values_under_the_pointer(browser, pages):
    with opened(browser, pages["record"].as_uri(), DESKTOP) as shown:
        shown.until(DRAWN)  # in one of the next frames
        data = "document.querySelector('figure.curves script').textContent"
        panels = json.loads(shown.page.evaluate(data))
        assert [panel["marks"] for panel in panels] == [[1.0, 9.0]] * 2
        assert [line["label"] for line in panels[0]["lines"]] == WIRES
        high = "document.querySelector('.view').getBoundingClientRect().height"
        before = shown.page.evaluate(high)
        shown.page.mouse.move(*place(shown, 0.5))
        time = time_shown(shown)
        assert time == pytest.approx(10.0, abs=0.5)
        value = float(shown.page.evaluate(VALUES)[1])
        assert value == pytest.approx(2.0 * (1.0 + 0.1 * np.sin(time)), abs=0.02)
        assert shown.page.evaluate(high) == before  # the figure does not move under the pointer
        assert shown.complaints == [] and shown.too_wide == []


def test_without_the_script_and_in_print_the_picture_is_shown(browser, pages):
    seen = """[...document.querySelectorAll('figure.curves img, .view')]
        .map((e) => [e.tagName, e.getClientRects().length > 0])"""
    back = "getComputedStyle(document.body).backgroundColor"
    url = pages["record"].as_uri()
    with opened(browser, url, scheme="dark") as shown:
        assert shown.page.evaluate(seen) == [["DIV", True], ["IMG", False]]
        shown.page.emulate_media(media="print")
        assert shown.page.evaluate(seen) == [["DIV", False], ["IMG", True]]
        assert shown.page.evaluate(back) == "rgb(255, 255, 255)"
        assert len(shown.page.pdf(format="A4")) > 10_000
    with opened(browser, url, java_script_enabled=False) as shown:
        assert shown.page.locator("figure.curves img").is_visible()


def test_a_script_from_elsewhere_does_not_run(browser, pages, tmp_path):
    """If a text were ever left unescaped, the page's policy would still stop a script."""
    path = tmp_path / "injected.html"
    text = pages["record"].read_text()
    path.write_text(text.replace("<h1>", "<script>document.title = 'mine'</script><h1>", 1))
    with opened(browser, path.as_uri()) as shown:
        assert shown.page.title() != "mine"
        assert len(shown.complaints) == 1 and "Content Security Policy" in shown.complaints[0]
