"""sma-bench calibrate SENSOR: gain and offset of a sensor of the Uno from known loads.

Pairs come from the command line, from a CSV file, or from the device while somebody applies one
known load after the other. The outputs stay off.
"""

import csv
import math
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sma_bench.commands import options
from sma_bench.commands.terminal import write_json
from sma_bench.errors import InputError
from sma_bench.hardware.calibration import SENSORS, SensorFit, fit_sensor
from sma_bench.hardware.conversation import open_port
from sma_bench.hardware.device import Reading
from sma_bench.hardware.serial_link import SerialLink
from sma_bench.parameters.node_tables import SERIAL_BRIDGE
from sma_bench.parameters.yaml_file import read_parameter_names, write_named_values

_TABLE = {parameter.name: parameter for parameter in SERIAL_BRIDGE}
_CONNECTING = 10.0
_AVERAGED = 100
"""readings of one known load, at 100 Hz"""


@options.command(
    "calibrate supply 5.91=6.00 8.87=9.01 11.83=12.02 --out lab.yaml",
    "calibrate front_current --csv front_current.csv --out lab.yaml",
)
@options.argument("sensor", "SENSOR", "sensor of the Uno", type=options.Words(sorted(SENSORS)))
@options.argument("pairs", "[READING=KNOWN...]", "device's reading (V, A) and known load (V, A, m)")
@options.option("--csv FILE", "two columns: reading, known load", type=options.Files())
@options.option("--device PORT", "read the device at this port")
@options.several(
    "--known LOAD",
    "with --device: the known loads, in the order in which they will be applied",
    type=float,
)
@options.option(
    "--shift M",
    "depth of a range sensor's lens behind its face in m (default: the parameter's)",
    type=float,
)
@options.output(
    "--out P.yaml", options.OWN, "parameter file to write; the other names in one that exists stay"
)
@options.json_option("the result")
def run(args: SimpleNamespace) -> int:
    """Fit, print, write."""
    kept = _kept(args)
    pairs = _pairs(args)
    readings, known = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    shift = _shift(args)
    fit = fit_sensor(args.sensor, readings, known, shift)
    for name, value in fit.parameters.items():
        _TABLE[name].validated(value, "calibrate")
    _show(args.sensor, fit, pairs)
    if args.json:
        std = {name: _finite(value) for name, value in fit.std.items()}
        rest = {"parameters": fit.parameters, "std": std, "rms": fit.rest, "pairs": pairs}
        write_json(args.json, {**rest, "uncertainty": fit.uncertainty})
    if args.out:
        values = {**kept, **fit.parameters, **_uncertainties(args.sensor, fit, kept)}
        write_named_values(args.out, values, "Calibration of the bench's Uno.")
        print(args.out)
    return 0


def _uncertainties(sensor: str, fit: SensorFit, kept: dict[str, Any]) -> dict[str, float]:
    """What identification is to believe of such readings: the worst of both boards, or sides."""
    found = {f"uncertainty.{name}": std for name, std in fit.uncertainty.items()}
    if not _others(sensor, kept):
        return found
    return {name: max(std, kept.get(name, 0.0)) for name, std in found.items()}


def _others(sensor: str, kept: dict[str, Any]) -> list[str]:
    """Sensors of the same quantity that were calibrated before."""
    alike = [s for s in SENSORS if s != sensor and SENSORS[s].quantity == SENSORS[sensor].quantity]
    return [s for s in alike if any(name.startswith(f"calibration.{s}.") for name in kept)]


def _kept(args: SimpleNamespace) -> dict[str, Any]:
    """What stays in --out; a calibration of this sensor in it goes with --force only."""
    if not args.out or not Path(args.out).exists():
        return {}
    if args.csv:
        options.keep_safe({"--out": (Path(args.out), options.FILE)}, [Path(args.csv)], True)
    kept = read_parameter_names(args.out)
    own = [name for name in kept if name.startswith(f"calibration.{args.sensor}.")]
    if not _others(args.sensor, kept):  # what a person has stated
        believed = f"uncertainty.sensor.{SENSORS[args.sensor].quantity}."
        own += [name for name in kept if name.startswith(believed)]
    if own and not args.force:
        raise InputError(f"{args.out}: holds {own[0]} already; --force replaces it")
    return kept


def _shift(args: SimpleNamespace) -> float:
    if not SENSORS[args.sensor].is_range:
        if args.shift is not None:
            raise InputError(f"--shift: {args.sensor} is no range sensor")
        return 0.0
    default = float(_TABLE[f"calibration.{args.sensor}.shift"].default)  # type: ignore[arg-type]
    return default if args.shift is None else float(args.shift)


def _pairs(args: SimpleNamespace) -> list[tuple[float, float]]:
    sources = [bool(args.pairs), bool(args.csv), bool(args.device)]
    if sum(sources) != 1:
        raise InputError("calibrate: expected pairs, or --csv FILE, or --device PORT")
    if args.device:
        if not args.known:
            raise InputError("--device: expected the known loads too, --known LOAD LOAD ...")
        return list(_measured(args.sensor, args.device, args.known))
    if args.csv:
        return _read_csv(args.csv)
    return [_pair(text.split("="), text) for text in args.pairs]


def _pair(words: Sequence[str], where: str) -> tuple[float, float]:
    try:
        reading, known = (float(word) for word in words)
    except ValueError:
        raise InputError(f"{where}: expected two numbers, reading and known load") from None
    return reading, known


def _read_csv(path: str) -> list[tuple[float, float]]:
    """Rows of two numbers; the first row may be a header."""
    try:
        rows = list(csv.reader(Path(path).read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read: {error}") from None
    numbered = [(k, row) for k, row in enumerate(rows, 1) if row and not row[0].startswith("#")]
    if numbered and not _is_number(numbered[0][1][0]):
        del numbered[0]
    return [_pair(row, f"{path} line {k}") for k, row in numbered]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _measured(sensor: str, port: str, known: Sequence[float]) -> Iterator[tuple[float, float]]:
    """A pair for each load, once the person at the bench has applied it."""
    readings: list[Reading] = []
    link = SerialLink(lambda: open_port(port), on_reading=readings.append)
    link.start()
    try:
        if not link.wait_connected(_CONNECTING):
            raise InputError(f"{port}: {link.status.problem or 'no answer'}")
        for load in known:
            print(f"apply {load:g} {SENSORS[sensor].known_unit}, then Enter: ", end="", flush=True)
            if not sys.stdin.readline():
                raise InputError("calibrate: ended before the last load")
            yield _mean(sensor, link, readings), load
    finally:
        link.close()


def _mean(sensor: str, link: SerialLink, readings: list[Reading]) -> float:
    """Mean of the next second of readings."""
    readings.clear()
    end = time.monotonic() + _CONNECTING
    while len(readings) < _AVERAGED:
        if time.monotonic() > end:
            raise InputError(f"calibrate: readings stopped: {link.status.problem or 'silence'}")
        time.sleep(0.01)
    values = [SENSORS[sensor].reading(reading.telemetry) for reading in readings[:_AVERAGED]]
    mean, unit = statistics.fmean(values), SENSORS[sensor].unit
    print(f"  {mean:.5g} {unit}, scatter {statistics.stdev(values):.2g} {unit}")
    return mean


def _show(sensor: str, fit: SensorFit, pairs: Sequence[tuple[float, float]]) -> None:
    for name, value in fit.parameters.items():
        std = fit.std.get(name, math.nan)
        error = f" +- {std:.2g}" if math.isfinite(std) else ""
        print(f"{name:32} {value:.6g}{error} {_TABLE[name].unit}")
    low, high = min(known for _, known in pairs), max(known for _, known in pairs)
    unit = SENSORS[sensor].known_unit
    for name, std in fit.uncertainty.items():
        print(f"{'uncertainty.' + name:32} {std:.2g}")
    print(
        f"{len(pairs)} pairs from {low:g} to {high:g} {unit}, rms of what is left {fit.rest:.2g} "
        f"{unit}"
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
