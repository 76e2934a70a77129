"""docs/first_power_on.md played on the emulated bench: its commands, its answers, its hands."""

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
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray
from uno.emulated_bench import emulated_bench

from sma_bench.cli import main
from sma_bench.parameters import Parameters

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "first_power_on.md"
PERIOD = 0.05
PATIENCE = 60.0
ANSWER = 5.0
CELSIUS_ZERO = 273.15
# What the bench has and the page finds out: divider, gain (V/A) and offset (V) of the sensor.
DIVIDER, GAIN, OFFSET = 4.08, 0.096, 0.012
_STEP = re.compile(r"^<!-- (by hand|when asked): (.*?) -->$|^```\n(.*?)^```", re.M | re.S)


def steps():
    """(kind, text, expected answer) of all that the page has somebody do."""
    for hand, action, block in _STEP.findall(PAGE.read_text()):
        if hand:
            yield hand, action, ""
        for line in block.splitlines():
            command, _, answer = line.partition("  # -> ")
            yield "command", command.strip(), answer.strip()


class PowerOn:
    """The reader: commands in the page's words, hands at the emulated bench."""

    def __init__(self, bench, hardware, folder):
        self.bench, self.hardware, self.folder = bench, hardware, folder
        self.electrics = hardware.uno.electrics
        self.port = folder / "uno"
        self.port.symlink_to(hardware.path)
        self.states, self.power = bench.hear("serial_bridge/state", "wire/power")
        # Their reader is still to come.
        self._command = bench.node.create_publisher(Float64MultiArray, "voltage_command", 100)
        self._camera = bench.node.create_publisher(Temperature, "wire/temperature", 100)
        self.node, self.volts, self.asked, self.camera, self._due = None, [], "", False, 0.0

    # --- hands ------------------------------------------------------------------------------------

    def by_hand(self, action):
        name, *values = action.split()
        number = float(values[0]) if values and name not in ("end", "kill") else math.inf
        if name in ("supply", "limit"):
            field = {"supply": "supply", "limit": "supply_limit"}[name]
            self.hardware.do(lambda: setattr(self.electrics, field, number))
        elif name in ("resistance", "disconnected"):
            self.hardware.do(lambda: self.electrics.resistance.__setitem__(0, number))
        elif name == "injected":
            self.hardware.do(lambda: self.electrics.offset.__setitem__(0, OFFSET + GAIN * number))
        elif name in ("plug", "unplug"):
            self.hardware.do(getattr(self.hardware.port, name))
            if name == "plug":
                self.port.unlink()
                self.port.symlink_to(self.hardware.path)
        elif name == "camera":
            self.camera = True
        else:
            assert name in ("end", "kill")
            self.volts = self.volts if name == "kill" else []
            self.node.end(signal.SIGKILL if name == "kill" else signal.SIGINT)
            self.off()

    def off(self):
        """No pulse any more, as the meter shows."""
        self.until(lambda: self.hardware.pins.off_for > 0.3)

    # --- commands ---------------------------------------------------------------------------------

    def run(self, command, expected):
        words = shlex.split(command.replace("/dev/serial/by-id/YOUR_UNO", str(self.port)))
        programs = {
            "./bench run": self._run_node, "./bench call": self._call,
            "./bench calibrate": self._calibrate, "ros2 topic pub": self._publish,
            "ros2 topic echo": self._echo,
        }
        name = next(name for name in programs if command.startswith(name))
        programs[name](words[len(name.split()) :], expected)

    def _run_node(self, words, expected):
        places = {"lab.yaml": self.folder, "config/wire_rig.yaml": ROOT}
        given = [str(places[word] / word) if word in places else word for word in words[1:]]
        self.states.clear()
        self.node = self.bench.start_with(words[0], given)
        self.until(lambda: expected in self.node.output)

    def _call(self, words, expected):
        """Asked again until it says so, as a reader would: links and readings take a moment."""
        said = ""

        def right():
            nonlocal said
            future, patience = self.bench.trigger_later(words[0]), time.monotonic() + ANSWER
            # A node that was killed may still seem to be there, and never answers.
            self.until(lambda: future.done() or time.monotonic() > patience)
            said = future.result().message if future.done() else "nothing"
            return expected in said

        self.until(right, lambda: f"{words[0]} says {said!r}, expected {expected!r}")

    def _calibrate(self, words, expected):
        loads = iter(words[words.index("--known") + 1 : words.index("--out")])

        def apply():
            self.by_hand(f"{self.asked} {next(loads)}")
            time.sleep(0.3)
            return "\n"

        stdin, sys.stdin = sys.stdin, SimpleNamespace(readline=apply)
        try:
            assert main(["calibrate", *words[:-1], str(self.folder / words[-1])]) == 0
        finally:
            sys.stdin = stdin
        sensor, key = expected.removeprefix("calibration.").split(".")
        assert key in self.calibrated()[sensor]

    def calibrated(self):
        written = yaml.safe_load((self.folder / "lab.yaml").read_text())
        return written["/**"]["ros__parameters"]["calibration"]

    def _publish(self, words, expected):
        assert words[:3] == ["-r", "20", "/bench/voltage_command"] and expected
        self.volts = yaml.safe_load(words[-1])["data"]

    def _echo(self, words, expected):
        def said():
            power = [(m.voltage, m.current) for m in self.power[-3:]]
            return f"{power}, {[s.data for s in self.states]}, expected {expected}"

        if words[-1].endswith("state"):
            self.until(lambda: self.states and self.states[-1].data.startswith(expected), said)
            self.off()
            return
        wanted = [float(number) for number in re.findall(r"[\d.]+", expected)]

        def as_written():
            newest = [(m.voltage, m.current) for m in self.power[-40:]]
            return len(newest) == 40 and [statistics.median(v) for v in zip(*newest, strict=True)
                                          ] == pytest.approx(wanted, rel=0.04)  # fmt: skip

        self.until(as_written, said)

    def until(self, condition, why=str):
        """Wait; the publisher and the camera go on meanwhile."""
        end = time.monotonic() + PATIENCE

        def step():
            now = time.monotonic()
            assert now < end, why()
            if now >= self._due:
                self._due = now + PERIOD
                if self.volts:
                    self._command.publish(Float64MultiArray(data=self.volts))
                if self.camera:
                    kelvin = float(self.hardware.plant.bench.temperature[0])
                    message = Temperature(temperature=kelvin - CELSIUS_ZERO)
                    message.header.stamp = self.bench.node.get_clock().now().to_msg()
                    self._camera.publish(message)
            return condition()

        self.bench.until(step, 2.0 * PATIENCE)


def test_every_command_of_the_page_has_its_answer():
    found = list(steps())
    assert len(found) > 40
    assert [text for kind, text, answer in found if kind == "command" and not answer] == []


@pytest.mark.acceptance
def test_the_page_can_be_followed_to_its_end(bench, uno, tmp_path):
    with emulated_bench(Parameters.defaults(), uno) as hardware:
        reader = PowerOn(bench, hardware, tmp_path)
        hardware.do(lambda: setattr(reader.electrics, "divider", DIVIDER))
        hardware.do(lambda: reader.electrics.volts_per_ampere.__setitem__(0, GAIN))
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
