"""sma-bench calibrate SENSOR: gain and offset of a sensor of the Uno from known loads.

Pairs come from the command line, from a CSV file, or from the device while somebody applies one
known load after the other. The outputs stay off.
"""

import csv
import math
import re
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
from sma_bench.hardware.calibration import SENSORS, fit_sensor
from sma_bench.hardware.conversation import open_port
from sma_bench.hardware.device import Reading
from sma_bench.hardware.serial_link import SerialLink
from sma_bench.parameters.node_tables import SERIAL_BRIDGE
from sma_bench.parameters.yaml_file import read_parameter_names, write_named_values

_TABLE = {parameter.name: parameter for parameter in SERIAL_BRIDGE}
_CONNECTING = 10.0
_AVERAGED = 100
"""readings of one known load, at 100 Hz"""


@options.command("calibrate")
def run(args: SimpleNamespace) -> int:
    """Fit, print, write; a calibration of this sensor that --out holds goes with --force only."""
    sensor, quantity = args.sensor, SENSORS[args.sensor].quantity
    unit = SENSORS[sensor].known_unit
    # What stays in --out, and which sensors of the same quantity it has.
    kept: dict[str, Any] = {}
    if args.out and Path(args.out).exists():
        if args.csv:
            options.keep_safe({"--out": (Path(args.out), options.FILE)}, [Path(args.csv)], True)
        kept = read_parameter_names(args.out)
    calibrated = {name.split(".")[1] for name in kept if name.startswith("calibration.")}
    others = [s for s in calibrated & set(SENSORS) - {sensor} if SENSORS[s].quantity == quantity]
    own = [f"calibration.{sensor}."]
    if not others:  # what a person has stated
        own.append(f"uncertainty.sensor.{quantity}.")
    if (held := [name for name in kept if name.startswith(tuple(own))]) and not args.force:
        raise InputError(f"{args.out}: holds {held[0]} already; --force replaces it")
    # The pairs, and the lens of a range sensor.
    if sum(map(bool, (args.pairs, args.csv, args.device))) != 1:
        raise InputError("calibrate: expected pairs, or --csv FILE, or --device PORT")
    if args.device and not args.known:
        raise InputError("--device: expected the known loads too, --known LOAD LOAD ...")
    if args.shift is not None and not SENSORS[sensor].is_range:
        raise InputError(f"--shift: {sensor} is no range sensor")
    if args.device:
        pairs = list(_measured(sensor, args.device, args.known))
    elif args.csv:
        pairs = _read_csv(args.csv)
    else:
        pairs = [_pair(text.split("="), text) for text in args.pairs]
    shift = args.shift
    if shift is None:
        shift = _TABLE[f"calibration.{sensor}.shift"].default if SENSORS[sensor].is_range else 0.0
    readings, known = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    fit = fit_sensor(sensor, readings, known, shift)
    for name, value in fit.parameters.items():
        _TABLE[name].validated(value, "calibrate")
    # What came of it; identification is to believe the worst of both boards, or sides.
    std = {name: value if math.isfinite(value) else None for name, value in fit.std.items()}
    for name, value in fit.parameters.items():
        error = f" +- {std[name]:.2g}" if std.get(name) is not None else ""
        print(f"{name:32} {value:.6g}{error} {_TABLE[name].unit}")
    for name, value in fit.uncertainty.items():
        print(f"{'uncertainty.' + name:32} {value:.2g}")
    print(
        f"{len(pairs)} pairs from {min(known):g} to {max(known):g} {unit}, rms of what is left "
        f"{fit.rest:.2g} {unit}"
    )
    if args.json:
        rest = {"parameters": fit.parameters, "std": std, "rms": fit.rest, "pairs": pairs}
        write_json(args.json, {**rest, "uncertainty": fit.uncertainty})
    if args.out:
        stated = {f"uncertainty.{name}": value for name, value in fit.uncertainty.items()}
        worst = {name: max(v, kept.get(name, 0.0)) if others else v for name, v in stated.items()}
        values = {**kept, **fit.parameters, **worst}
        write_named_values(args.out, values, "Calibration of the bench's Uno.")
        print(args.out)
    return 0


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
    if numbered and not re.match(r"\s*[-+.\d]", numbered[0][1][0]):
        del numbered[0]
    return [_pair(row, f"{path} line {k}") for k, row in numbered]


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
            readings.clear()
            end = time.monotonic() + _CONNECTING
            while len(readings) < _AVERAGED:
                if time.monotonic() > end:
                    problem = link.status.problem or "silence"
                    raise InputError(f"calibrate: readings stopped: {problem}")
                time.sleep(0.01)
            values = [SENSORS[sensor].reading(r.telemetry) for r in readings[:_AVERAGED]]
            mean, unit = statistics.fmean(values), SENSORS[sensor].unit
            print(f"  {mean:.5g} {unit}, scatter {statistics.stdev(values):.2g} {unit}")
            yield mean, load
    finally:
        link.close()
