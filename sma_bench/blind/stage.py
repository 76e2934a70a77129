"""One rig under the drives of its two records, played with any set of features."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from sma_bench.blind.drives import COMMAND_PERIOD, Drive
from sma_bench.blind.reality import Outcome, World, happen
from sma_bench.blind.rigs import CHANNELS, SIDES, rig_of
from sma_bench.blind.sensors import Sensors, readings
from sma_bench.parameters import Parameters

Array = npt.NDArray[np.float64]

RECORDS = ("record", "hold_out")
PER_WIRE = ("current", "temperature")
# 20 ms instead of 5 ms inside: enough to size an effect, and for sensitivities.
COARSE = 0.25


@dataclass(frozen=True)
class Stage:
    """A rig, its instruments and what it is driven with.

    Attributes:
        truth: the rig's true numbers.
        sensors: its instruments.
        drives: by record.
    """

    truth: Parameters
    sensors: Sensors
    drives: Mapping[str, Drive]
    _played: dict[Any, Outcome] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def from_label(cls, label: Mapping[str, Any]) -> Self:
        """The stage of a case; its features are label["features"] and, without the effect,
        label["base"]."""
        drives = {name: Drive.from_json(drive) for name, drive in label["drives"].items()}
        return cls(rig_of(label["truth"]), Sensors.from_json(label["sensors"]), drives)

    def play(
        self,
        features: Mapping[str, float],
        record: str,
        fine: float = 1.0,
        parameters: Parameters | None = None,
    ) -> Outcome:
        """What happens in a record under these features, every 20 ms.

        Args:
            features: of the world.
            record: name of the drive.
            fine: steps are at most 5 ms/fine long.
            parameters: instead of the rig's true ones.
        """
        key = (record, fine, id(parameters), *sorted(_physical(features).items()))
        if parameters is None and key in self._played:
            return self._played[key]
        time = self.drives[record].grid(COMMAND_PERIOD)
        world = World(parameters or self.truth, features)
        outcome = happen(world, time, self.drives[record].voltage(time), fine)
        if parameters is None:
            self._played[key] = outcome
        return outcome

    def read(
        self,
        features: Mapping[str, float],
        record: str,
        fine: float = 1.0,
        parameters: Parameters | None = None,
    ) -> dict[str, Array]:
        """What the instruments would read without noise: signal -> (n,), every 20 ms."""
        outcome = self.play(features, record, fine, parameters)
        clean = readings(outcome, World(self.truth, features), self.sensors)
        signals = {
            f"{channel}.{quantity}": clean[quantity][:, wire]
            for quantity in PER_WIRE
            for wire, channel in enumerate(CHANNELS)
        }
        return {**signals, "deflection": clean["deflection"]}

    def peak_current(self) -> float:
        """A; the largest of both records in the baseline."""
        volts = (np.max(d.voltage(d.grid(COMMAND_PERIOD))) for d in self.drives.values())
        return float(max(volts) / self.truth["wire.resistance"])


_SENSOR_FEATURES = (
    "spot_fill", "camera_lag", "deflection_drift", "sensor_nonlinearity", "pickup", "shutter_steps",
)


def _physical(features: Mapping[str, float]) -> dict[str, float]:
    """Without what only the instruments do: the outcome is the same."""
    return {name: value for name, value in features.items() if name not in _SENSOR_FEATURES}


def quantity_of(signal: str) -> str:
    """`temperature` of `front_1.temperature`."""
    return signal.rpartition(".")[2]


def gaps(
    one: Mapping[str, Array],
    other: Mapping[str, Array],
    sensors: Sensors,
    quantities: Iterable[str],
) -> dict[str, float]:
    """Root mean square of the difference over the noise, for every signal of the quantities."""
    wanted = set(quantities)
    return {
        name: float(np.sqrt(np.mean((one[name] - other[name]) ** 2)) / sensors.std(quantity))
        for name in one
        if (quantity := quantity_of(name)) in wanted
    }


def largest(gap: Mapping[str, float]) -> float:
    """The gap of the signal that shows it best."""
    return max(gap.values())


def phases(drive: Drive) -> tuple[npt.NDArray[np.str_], npt.NDArray[np.str_]]:
    """(n,) drive, rest or initial, and (n,) the side driven now or last ("" before)."""
    time = drive.grid(COMMAND_PERIOD)
    driven = drive.voltage(time) > 0.0
    phase = np.full(len(time), "rest", dtype="<U7")
    phase[driven.any(axis=1)] = "drive"
    started = np.maximum.accumulate(driven.any(axis=1))
    phase[~started] = "initial"
    side = np.full(len(time), "", dtype="<U5")
    for pulse in drive.pulses:
        side[time >= pulse.times[0]] = pulse.side
    return phase, side


def where(
    with_effect: Mapping[str, Array],
    without: Mapping[str, Array],
    stage: Stage,
    record: str,
    quantities: Iterable[str],
) -> list[dict[str, Any]]:
    """The gap by signal, phase and side, largest share first.

    Returns:
        Rows of signal, phase, side, gap (over noise, root mean square in the cell) and share (of
        the squared gaps over noise of all samples that the record holds).
    """
    phase, side = phases(stage.drives[record])
    rows = []
    for name in gaps(with_effect, without, stage.sensors, quantities):
        quantity = quantity_of(name)
        square = ((with_effect[name] - without[name]) / stage.sensors.std(quantity)) ** 2
        here = np.full(len(side), _side_of(name)) if quantity in PER_WIRE else side
        for p, s in sorted(set(zip(phase.tolist(), here.tolist(), strict=True))):
            cell = square[(phase == p) & (here == s)]
            energy = float(cell.sum() * stage.sensors.rate(quantity))
            row = {"signal": name, "phase": p, "side": s, "gap": float(np.sqrt(cell.mean()))}
            rows.append({**row, "share": energy})
    total = sum(row["share"] for row in rows) or 1.0
    rows = [{**row, "share": row["share"] / total} for row in rows]
    return sorted(rows, key=lambda row: -row["share"])


def _side_of(signal: str) -> str:
    return SIDES[CHANNELS.index(signal.partition(".")[0])]
