"""The page in a real browser: looks, the stop by mouse and key, what it says when left alone."""

import json
from contextlib import ExitStack

import pytest
from browser_page import PHONE, opened
from stand_in import StandIn, served

from sma_bench.dashboard import server
from sma_bench.dashboard.live_state import Seen, shown_limits

EVIL = "<img src=x onerror=alert(1)>"
SETTLED = "document.querySelectorAll('.plot').length === 3"
ANSWERED = "!document.getElementById('stop').hasAttribute('aria-busy')"
# The page must show what it cannot reach; a browser complains of that too.
EXPECTED = ("ERR_CONNECTION_REFUSED", "WebSocket connection to")


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.setattr(server, "_STAYS_OFF", 0.3)
    made = StandIn()
    later = made.state.clock() + 1e6
    limits = {"bench.maximum_temperature": 423.15, "bench.maximum_current": 3.0}
    for panel, shown in {
        "limits": {"values": shown_limits(limits), "of": ["serial_bridge"]},
        "channels": ["front_1", "back_1"],
        "there": ["experiment", EVIL],
        "stops": ["serial_bridge", EVIL],
        "states": {"experiment": "running: staircase", EVIL: EVIL, "lost": "idle"},
        "diagnostics": {
            "simulator: bench": {"level": "warning", "message": EVIL, "heard": later},
            "camera": {"level": "ok", "message": "", "heard": later},
        },
        "progress": {
            "protocol": "staircase", "step": "hold at 3 V", "elapsed": 30.0, "duration": 120.0,
            "node": "experiment", "heard": later,
        },
        "diagnosis": {
            "title": "The gap is explained by side_heat_coupling.",
            "lines": ["deflection: error 1.2 mm rms before, 0.2 mm after, noise 0.1 mm", EVIL],
            "rows": [],
        },
    }.items():  # fmt: skip
        made.state.show(panel, shown)
    return made


@pytest.fixture
def url(bench):
    with served(bench) as found, bench.readings():
        yield found


def assert_readable(shown):
    assert shown.too_wide == [] and shown.faint == [] and shown.complaints == []


def test_it_shows_signals_limits_progress_nodes_and_results_as_text(browser, bench, url):
    bench.celsius = 80.0
    bench.state.show("works", ["identify"])
    bench.state.show("recorded", "monday")
    bench.state.show("identification", {
        "title": "2 numbers", "lines": ["a warning"],
        "rows": [("wire.resistance", "2.7 ± 0.03 ohm"), ("wire.mass", EVIL)],
    })  # fmt: skip
    with opened(browser, url) as shown:
        shown.until(SETTLED)
        for selector, texts in {
            "#protocol": ["staircase, hold at 3 V: 30.0 of 120 s"],
            "#heat": ["limit 150.0 °C, of serial_bridge", "80.0 °C"],
            "#plots": ["front_1 3.00 V commanded 3.00 V"],
            "#nodes": [EVIL, "gone (last: idle)"], "#diagnosis": [EVIL, "0.2 mm after"],
            "#identification-content": [EVIL, "2.7 ± 0.03 ohm", "a warning"],
        }.items():  # fmt: skip
            said = shown.text(selector)
            assert [text for text in texts if text not in said] == []
        assert shown.page.evaluate("document.getElementById('protocol-bar').value") == 0.25
        heat = shown.text("#heat")
        assert heat.index("front_1") < heat.index("back_1")
        assert_readable(shown)
        bench.celsius = 160.0
        shown.until("document.querySelectorAll('.meter.over').length === 2")
        assert "160.0 °C over" in shown.text("#heat")
        drawn = """[...document.querySelectorAll('canvas')].map((canvas) => canvas.getContext('2d')
            .getImageData(0, 0, canvas.width, canvas.height).data.some((byte) => byte > 0))"""
        shown.until(f"JSON.stringify({drawn}) === '[true,true,true]'")
        bench.state.reading("deflection", "tip", 1e306)  # beyond any bench
        shown.until("document.getElementById('plots').innerText.includes('tip none')")
        # Records are worked on from the page.
        assert "Diagnose" not in shown.text("#work")
        for records in ("", "tuesday 'wednes day'"):
            if records:
                shown.page.fill("#records", records)
            shown.page.click("#work-form button[value=identify]")
            shown.until("document.getElementById('work-said').innerText === 'identify: begun'")
        shown.page.keyboard.press("Escape")
        shown.until(ANSWERED)
        assert_readable(shown)
    assert bench.work == [("identify", ["monday"]), ("identify", ["tuesday", "wednes day"])]


def test_current_that_still_flows_is_shown_largest_until_it_ends(browser, bench, url):
    told = "still flowing: pull the plug (4.43 A through the front board with its outputs off)"
    with opened(browser, url, PHONE, "dark") as shown:
        shown.until(SETTLED)
        assert_readable(shown)
        assert shown.page.evaluate("document.getElementById('plug').hidden")
        bench.state.merge("states", {"serial_bridge": told})
        shown.until("!document.getElementById('plug').hidden")
        said = shown.text("#plug")
        assert "PULL THE PLUG" in said and told in said
        font = """[...document.querySelectorAll('body *')].map(
            (shown) => parseFloat(getComputedStyle(shown).fontSize))"""
        sizes = shown.page.evaluate(font)
        loudest = "parseFloat(getComputedStyle(document.querySelector('#plug strong')).fontSize)"
        assert sizes.count(max(sizes)) == 1 and shown.page.evaluate(loudest) == max(sizes)
        assert shown.page.evaluate("document.title").startswith("PULL THE PLUG")
        assert_readable(shown)
        bench.state.merge("states", {"serial_bridge": "stopped: current with all outputs off"})
        shown.until("document.getElementById('plug').hidden")
        assert not shown.page.evaluate("document.title").startswith("PULL")
        shown.page.keyboard.press("Escape")
        shown.until(ANSWERED)
        assert_readable(shown)


def test_the_stop_works_by_key_and_mouse_and_without_javascript_and_shows_what_came_of_it(
    browser, bench, url
):
    with opened(browser, url, java_script_enabled=False) as shown:
        shown.page.click("#stop")
        assert json.loads(shown.page.inner_text("body"))["stopped"] is True
    result = "document.getElementById('stop-result').className === '{}'"
    with opened(browser, url) as shown:
        shown.until(SETTLED)
        for k, how in enumerate(("Escape", "Enter", "click")):
            if how == "click":
                shown.page.mouse.click(60, 40)
            else:
                shown.page.keyboard.press(how)
            shown.until(result.format("ok"))
            assert bench.stops == k + 2
            said = shown.text("#stop-result")
            assert "0 V read on all 2 wires" in said and "serial_bridge: stopped" in said
            assert "front_1 0.00 V, back_1 0.00 V" in said
            bench.volts["back_1"] = 5.0  # a voltage that comes back after the stop
            shown.until(result.format("bad"))
            assert "VOLTAGE IS ON AGAIN: back_1 5.00 V" in shown.text("#stop-result")
        bench.obeys, bench.volts = False, dict.fromkeys(bench.volts, 3.0)
        shown.page.keyboard.press("Escape")
        off = "NOT STOPPED, voltage is on: front_1 3.00 V, back_1 3.00 V"
        shown.until(f"document.getElementById('stop-result').innerText.includes('{off}')")
        shown.until(ANSWERED + " && " + result.format("bad"))


def test_data_that_the_page_cannot_show_is_lost_and_never_an_old_reading(browser, bench, url):
    run = {"protocol": "p", "step": "s", "elapsed": 1.0, "duration": "30", "heard": 0.0}
    with opened(browser, url) as shown:
        for k, (panel, wrong) in enumerate((
            ("progress", {**run, "node": "experiment"}),
            ("limits", {"values": {"temperature": "hot"}, "of": []}),
            ("diagnostics", {"camera": None}),
        )):  # fmt: skip
            shown.until("document.body.className === 'live'")
            right = bench.state.update(Seen())["panels"].get(panel)
            bench.state.show(panel, wrong)
            bench.celsius = 140.0 + k
            shown.until("document.body.className === 'lost'")
            assert "LOST: this page cannot show what the bench sends" in shown.text("#connection")
            assert "°C" not in shown.text("#meters") and " V" not in shown.text(".legend")
            bench.state.show(panel, right)
            shown.until("document.body.className === 'live'")
            shown.until(f"document.getElementById('meters').innerText.includes('{140 + k}.0 °C')")


def test_a_silent_bench_is_not_shown_as_live_and_a_lost_one_is_red_and_leaves_no_number(
    browser, bench
):
    bench.volts = dict.fromkeys(bench.volts, 0.0)
    with ExitStack() as page:
        with served(bench) as url:
            shown = page.enter_context(opened(browser, url))
            with bench.readings():
                shown.until("document.body.className === 'live'")
                shown.page.keyboard.press("Escape")
                shown.until("document.getElementById('stop-result').className === 'ok'")
            shown.until("document.body.className === 'waiting'")
            shown.until("document.getElementById('meters').innerText.includes('silent')")
            assert "°C" not in shown.text("#meters")
            assert "6 of 6 signals are silent" in shown.text("#connection")
            with bench.readings():
                shown.until("document.body.className === 'live'")
        shown.until("document.body.className === 'lost'")
        assert "CONNECTION LOST" in shown.text("#connection")
        assert "°C" not in shown.text("#meters") and " V" not in shown.text(".legend")
        assert shown.text("#protocol-text") == "unknown: connection lost"
        assert shown.page.evaluate("document.getElementById('stop-result').className") == "old"
        assert shown.text("#stop-result").startswith("From before the connection was lost:")
        states = "[...document.querySelectorAll('#node-rows td:last-child')].map(e => e.innerText)"
        assert set(shown.page.evaluate(states)) == {"unknown"}
        shown.page.keyboard.press("Escape")
        shown.until(ANSWERED)
        assert shown.text("#stop-result").startswith("NOT CONFIRMED: the dashboard does not answer")
        back = "getComputedStyle(document.getElementById('stop-result')).backgroundColor"
        assert shown.page.evaluate(back) == "rgb(179, 20, 27)"
        assert [c for c in shown.complaints if not any(e in c for e in EXPECTED)] == []
