"""The walks of docs/architecture.md through the running code: every file they name, in order."""

import re
import sys
from pathlib import Path

import pytest
from planted import few_effects

import sma_bench
from sma_bench.cli import main
from sma_bench.live.virtual_bench import SimulatedRun
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol

PACKAGE = Path(sma_bench.__file__).parent
PAGE = PACKAGE.parent / "docs" / "architecture.md"
PULSE = {"name": "pulse", "steps": [{"kind": "hold", "level": 2.0, "duration": 1.0}]}


def walks():
    """Files of each walk of the page, by the text that it begins with."""
    paragraphs = PAGE.read_text().split("\n\n")
    found = [re.match(r"\*\*(.*?)\*\*", text) for text in paragraphs]
    return {
        head[1]: re.findall(r"`([\w/]+\.py)`", text)
        for head, text in zip(found, paragraphs, strict=True)
        if head
    }


def files_of(work):
    """Files of the package whose functions run in `work`, in the order of their first call."""
    seen = {}

    def note(frame, event, _):
        name = frame.f_code.co_filename
        if event == "call" and frame.f_code.co_name != "<module>":
            seen.setdefault(name)

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    inside = (Path(name) for name in seen if name.startswith(str(PACKAGE)))
    return [path.relative_to(PACKAGE).as_posix() for path in inside]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk") / "bag"
    arguments = ["--protocol", "quick_staircase", "--noise", "1", "--rate", "10"]
    assert main(["simulate", *arguments, "--out", str(folder)]) == 0
    return str(folder)


def live(_):
    bench = Parameters.defaults()
    run = SimulatedRun(bench, bench, seed=1)
    return lambda: run.follow(parse_protocol(PULSE, bench))


def diagnosed(bag):
    def work():  # every call is looked at: beside two effects the walk is the same
        with few_effects(("supply_drop", "latent_heat")):
            main(["diagnose", bag])

    return work


PLAYED = {"A bag to R": lambda bag: lambda: main(["identify", bag]),
          "A bag to a verdict": diagnosed, "A volt to a temperature": live}  # fmt: skip


def test_every_walk_of_the_page_is_played():
    assert walks().keys() == PLAYED.keys()


@pytest.mark.parametrize("walk", PLAYED)
def test_a_walk_calls_the_files_that_the_page_names(walk, bag, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")  # what threads call is not looked at
    named, work = walks()[walk], PLAYED[walk](bag)
    work()  # imports and first-time work apart
    called = files_of(PLAYED[walk](bag))
    assert len(named) >= 4
    assert [name for name in called if name in named] == named


def test_the_ten_files_exist():
    story = re.findall(r"^\d+\. `(.*?)`", PAGE.read_text(), re.MULTILINE)
    assert len(story) == 10 and all((PACKAGE / name).is_file() for name in story)
