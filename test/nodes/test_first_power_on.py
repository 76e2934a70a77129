"""docs/first_power_on.md executed on the emulated bench: commands, answers and manual steps."""

import math
import re
import shlex
import signal
import statistics
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from emulated_rig import Commander
from uno.emulated_bench import emulated_bench

from sma_bench.cli import main
from sma_bench.parameters import Parameters

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "first_power_on.md"
PATIENCE = 60.0
ANSWER = 5.0
# Properties of the bench that the page determines: divider, sensor gain (V/A) and offset (V).
DIVIDER, GAIN, OFFSET = 4.08, 0.096, 0.012
_STEP = re.compile(r"^<!-- (by hand|when asked): (.*?) -->$|^```\n(.*?)^```", re.M | re.S)


def steps():
    """(kind, text, expected answer) of all steps of the page."""
    for hand, action, block in _STEP.findall(PAGE.read_text()):
        if hand:
            yield hand, action, ""
        for line in block.splitlines():
            command, _, answer = line.partition("  # -> ")
            yield "command", command.strip(), answer.strip()


class Reader(Commander):
    """Runs the page's commands and does its manual steps on the emulated bench."""

    def __init__(self, bench, hardware, folder):
        super().__init__(bench, hardware)
        self.voltage = self.fever = None  # no publisher and no camera yet
        self.folder, self.asked = folder, ""
        self.port = folder / "uno"
        self.port.symlink_to(hardware.path)

    def by_hand(self, action):
        name, *values = action.split()
        electrics = self.hardware.uno.electrics
        number = float(values[0]) if values and name not in ("end", "kill") else math.inf
        hands = {"supply": lambda: setattr(electrics, "supply", number),
                 "limit": lambda: setattr(electrics, "supply_limit", number),
                 "resistance": lambda: electrics.resistance.__setitem__(0, number),
                 "disconnected": lambda: electrics.resistance.__setitem__(0, number),
                 "injected": lambda: electrics.offset.__setitem__(0, OFFSET + GAIN * number),
                 "plug": self.hardware.port.plug, "unplug": self.hardware.port.unplug,
                 "camera": lambda: setattr(self, "fever", 0.0)}  # fmt: skip
        if name in hands:
            self.hardware.do(hands[name])
            if name == "plug":
                self.port.unlink()
                self.port.symlink_to(self.hardware.path)
            return
        numbers = {"kill": signal.SIGKILL, "end": signal.SIGINT}
        self.voltage = self.voltage if name == "kill" else None
        self.node.end(numbers[name])
        self.off()

    def off(self):
        """No pulses any more, as a meter would show."""
        self.until(lambda: self.hardware.pins.off_for > 0.3, PATIENCE)

    def run(self, command, expected):
        words = shlex.split(command.replace("/dev/serial/by-id/YOUR_UNO", str(self.port)))
        programs = {"./bench run": self._run_node, "./bench call": self._call,
                    "./bench calibrate": self._calibrate, "ros2 topic pub": self._publish,
                    "ros2 topic echo": self._echo}  # fmt: skip
        name = next(name for name in programs if command.startswith(name))
        programs[name](words[len(name.split()) :], expected)

    def _run_node(self, words, expected):
        places = {"lab.yaml": self.folder, "config/wire_rig.yaml": ROOT}
        given = [str(places[word] / word) if word in places else word for word in words[1:]]
        self.states.clear()
        self.node = self.bench.start_with(words[0], given)
        self.until(lambda: expected in self.node.output, PATIENCE)

    def _call(self, words, expected):
        """Repeat the command until it answers so, as a reader would: links take a moment."""

        def right():
            future, patience = self.bench.trigger_later(words[0]), time.monotonic() + ANSWER
            # A killed node may still be in the graph, but never answers.
            self.until(lambda: future.done() or time.monotonic() > patience, PATIENCE)
            said = future.result().message if future.done() else "nothing"
            print(f"{words[0]} says {said!r}, expected {expected!r}")
            return expected in said

        self.until(right, PATIENCE)

    def _calibrate(self, words, expected):
        loads = iter(words[words.index("--known") + 1 : words.index("--out")])

        def apply():
            self.by_hand(f"{self.asked} {next(loads)}")
            time.sleep(0.3)
            return "\n"

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "stdin", SimpleNamespace(readline=apply))
            assert main(["calibrate", *words[:-1], str(self.folder / words[-1])]) == 0
        sensor, key = expected.removeprefix("calibration.").split(".")
        assert key in self.calibrated()[sensor]

    def calibrated(self):
        written = yaml.safe_load((self.folder / "lab.yaml").read_text())
        return written["/**"]["ros__parameters"]["calibration"]

    def _publish(self, words, expected):
        assert words[:3] == ["-r", "20", "/bench/voltage_command"] and expected
        self.voltage = yaml.safe_load(words[-1])["data"]

    def _echo(self, words, expected):
        if words[-1].endswith("state"):
            self.until(lambda: self.state.startswith(expected), PATIENCE)
            self.off()
            return
        wanted = [float(number) for number in re.findall(r"[\d.]+", expected)]

        def as_written():
            newest = [(m.voltage, m.current) for m in self.power[-40:]]
            read = [statistics.median(values) for values in zip(*newest, strict=True)]
            return len(newest) == 40 and read == pytest.approx(wanted, rel=0.04)

        self.until(as_written, PATIENCE)


def test_every_command_of_the_page_has_its_answer():
    found = list(steps())
    assert len(found) > 40
    assert [text for kind, text, answer in found if kind == "command" and not answer] == []


@pytest.mark.acceptance
def test_the_page_can_be_followed_to_its_end(bench, uno, tmp_path):
    with emulated_bench(Parameters.defaults(), uno) as hardware:
        reader, electrics = Reader(bench, hardware, tmp_path), hardware.uno.electrics
        hardware.do(lambda: setattr(electrics, "divider", DIVIDER))
        hardware.do(lambda: electrics.volts_per_ampere.__setitem__(0, GAIN))
        reader.by_hand("injected 0")
        for kind, text, answer in steps():
            print(f"{kind}: {text}", flush=True)
            if kind == "by hand":
                reader.by_hand(text)
            elif kind == "when asked":
                reader.asked = text
            else:
                reader.run(text, answer)
    values = reader.calibrated()
    assert values["supply"]["gain"] == pytest.approx(DIVIDER / 4.0, rel=0.01)
    assert values["front_current"]["gain"] == pytest.approx(0.1 / GAIN, rel=0.01)
    assert values["front_current"]["offset"] == pytest.approx(-OFFSET / GAIN, abs=0.02)
