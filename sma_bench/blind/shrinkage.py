"""How far a gap truly shrinks: the case's own world, without noise, on a drive nobody saw.

The reality plays the drive; the model is simulated with the lab's parameters and with those of the
answer; the root mean square of the differences before and after is the truth that a claim is
measured against.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sma_bench.blind.drives import Drive, Pulse
from sma_bench.blind.judgement import Shrunk
from sma_bench.blind.rigs import CHANNELS
from sma_bench.blind.simulated import simulated_reading
from sma_bench.blind.stage import PER_WIRE, Stage
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.physics.simulate import simulate

Array = npt.NDArray[np.float64]

UNSEEN = "unseen"
_DURATION = 110.0
# Starts and lengths in s of smooth hills, back and front by turns, and their heights as a share of
# the highest voltage of the case's records: two that transform fully and two that may not.
_HILLS = ((5.0, 20.0, 1.0), (31.0, 18.0, 0.98), (56.0, 16.0, 0.9), (79.0, 22.0, 0.94))
_CORNERS = 17


def unseen_drive(drives: Mapping[str, Drive]) -> Drive:
    """Raised cosines that reach as high as a case's own records; no family of theirs."""
    highest = max(max(pulse.volts) for drive in drives.values() for pulse in drive.pulses)
    phase = np.linspace(0.0, 1.0, _CORNERS)
    shape = (1.0 - np.cos(2.0 * np.pi * phase)) / 2.0
    pulses = tuple(
        Pulse(
            ("back", "front")[k % 2],
            tuple(np.round(start + length * phase, 2).tolist()),
            tuple((height * highest * np.sqrt(shape)).tolist()),
        )
        for k, (start, length, height) in enumerate(_HILLS)
    )
    return Drive(UNSEEN, _DURATION, pulses)


class UnseenRecord:
    """What a case's world does on the unseen drive, as perfect instruments would read it."""

    def __init__(self, label: Mapping[str, Any]) -> None:
        """Play the world of a sealed label."""
        seen = Stage.from_label(label)
        self.stage = replace(seen, drives={UNSEEN: unseen_drive(seen.drives)})
        outcome = self.stage.play(label["features"], UNSEEN)
        self.time, self.voltage = outcome.time, outcome.voltage
        self.readings = self.stage.read(label["features"], UNSEEN)

    def gaps(self, parameters: Parameters) -> dict[str, float]:
        """Root mean square of measured less simulated, of every signal and every quantity."""
        simulation = simulate(parameters, self.time, self.voltage)
        square = {
            signal: float(np.mean((read - simulated_reading(simulation, signal)) ** 2))
            for signal, read in self.readings.items()
        }
        for quantity in PER_WIRE:
            of_wires = [square[f"{channel}.{quantity}"] for channel in CHANNELS]
            square[quantity] = float(np.mean(of_wires))
        return {name: float(np.sqrt(value)) for name, value in square.items()}

    def shrunk(self, nominal: Parameters, improved: Parameters) -> dict[str, Shrunk]:
        """The true shrinkage by signal (`front_1.temperature`) and quantity (`temperature`)."""
        before, after = self.gaps(nominal), self.gaps(improved)
        return {
            name: Shrunk(
                before[name], after[name], self.stage.sensors.std(name.rpartition(".")[2])
            )
            for name in before
        }


def parameter_error(truth: Mapping[str, float], nominal: Parameters, lab: Parameters) -> float:
    """Root mean square error of `lab` in the standard deviations that `nominal` states."""
    stated = {name: std for name, std in nominal.given_uncertainty.items() if name in truth}
    errors = [(lab[name] - truth[name]) / std for name, std in stated.items() if std > 0.0]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


def parameters_of(nominal: Path, improved: Path | None) -> tuple[Parameters, Parameters]:
    """The lab's parameters and the improved ones, which are the same where there is no file."""
    before = read_parameters(nominal)
    return before, before if improved is None else read_parameters(improved)
