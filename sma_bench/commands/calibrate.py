"""sma-bench calibrate SENSOR: gain and offset of a sensor of the Uno, from pairs of reading and
known load: typed, from a CSV file, or read from the device while the user applies the loads."""

import csv
import math
import os
import re
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sma_bench.border import MEGABYTE, read_text
from sma_bench.commands import options
from sma_bench.commands.terminal import write_json
from sma_bench.errors import InputError
from sma_bench.hardware.bench_sensors import SENSORS, fit_sensor
from sma_bench.hardware.serial_link import SerialLink, open_port
from sma_bench.hardware.serial_messages import Telemetry
from sma_bench.parameters.node_tables import SERIAL_BRIDGE
from sma_bench.parameters.yaml_file import read_parameter_names, write_named_values
from sma_bench.results import in_unit, with_error

_TABLE = {parameter.name: parameter for parameter in SERIAL_BRIDGE}
_CONNECTING = 10.0  # s, timeout for the connection, and for the readings of one load
_AVERAGED = 100  # readings per known load: 1 s at 100 Hz


@options.command("calibrate")
def run_calibrate(args: SimpleNamespace) -> int:
    """Fit, print, write; --out may replace a calibration of this sensor with --force only."""
    name, sensor = args.sensor, SENSORS[args.sensor]
    # Parameters in --out that are kept, and other sensors of the same quantity calibrated there.
    kept: dict[str, Any] = {}
    if args.out and os.path.exists(args.out):
        if args.csv:
            options.keep_safe({"--out": (Path(args.out), options.FILE)}, [Path(args.csv)], True)
        kept = read_parameter_names(args.out)
    calibrated = {key.split(".")[1] for key in kept if key.startswith("calibration.")}
    alike = {other for other in SENSORS if SENSORS[other].quantity == sensor.quantity}
    others = calibrated & alike - {name}
    own = [f"calibration.{name}.", *([] if others else [f"uncertainty.sensor.{sensor.quantity}."])]
    if (held := [key for key in kept if key.startswith(tuple(own))]) and not args.force:
        raise InputError(f"{args.out}: contains {held[0]} already; --force replaces it")
    # The pairs, and the depth of a range sensor's lens.
    if sum(map(bool, (args.pairs, args.csv, args.device))) != 1:
        raise InputError("calibrate: expected pairs, or --csv FILE, or --device PORT")
    if args.device and not args.known:
        raise InputError("--device: expected the known loads too, --known LOAD LOAD ...")
    if args.shift is not None and not sensor.is_range:
        raise InputError(f"--shift: {name} is not a range sensor")
    if args.device:
        pairs = list(_measured(name, args.device, args.known))
    elif args.csv:
        lines = read_text(args.csv, MEGABYTE).splitlines()
        rows = [(k, r) for k, r in enumerate(csv.reader(lines), 1) if r and r[0][:1] != "#"]
        if rows and not re.match(r"\s*[-+.\d]", rows[0][1][0]):
            del rows[0]  # a header
        pairs = [_pair(row, f"{args.csv} line {k}") for k, row in rows]
    else:
        pairs = [_pair(text.split("="), text) for text in args.pairs]
    shift = args.shift
    if shift is None:
        shift = _TABLE[f"calibration.{name}.shift"].default if sensor.is_range else 0.0
    readings, known = zip(*pairs, strict=True) if pairs else ((), ())
    fit = fit_sensor(name, readings, known, shift)
    for key, value in fit.parameters.items():
        _TABLE[key].validated(value, "calibrate")
    # The result. Both sensors of a quantity share one uncertainty: that of the worse one.
    std = {key: value if math.isfinite(value) else None for key, value in fit.std.items()}
    for key, value in fit.parameters.items():
        print(f"{key:32} {in_unit(with_error(value, std.get(key) or 0.0), _TABLE[key].unit)}")
    stated = {f"uncertainty.{key}": value for key, value in fit.uncertainty.items()}
    for key, value in stated.items():
        print(f"{key:32} {value:.2g}")
    unit = sensor.known_unit
    span = f"{len(pairs)} pairs from {min(known):g} to {max(known):g} {unit}"
    print(f"{span}, rms residual {fit.rest:.2g} {unit}")
    write_json(args.json, {"parameters": fit.parameters, "std": std, "rms": fit.rest,
                           "pairs": pairs, "uncertainty": fit.uncertainty})
    if args.out:
        worst = {key: max(v, kept.get(key, 0.0)) if others else v for key, v in stated.items()}
        values = {**kept, **fit.parameters, **worst}
        write_named_values(args.out, values, "Calibration of the bench's Uno.", args.out)
        print(args.out)
    return 0


def _pair(words: Sequence[str], where: str) -> tuple[float, float]:
    try:
        reading, known = (float(word) for word in words)
    except ValueError:
        raise InputError(f"{where}: expected two numbers, reading and known load") from None
    return reading, known


def _measured(name: str, port: str, known: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Reading and load, for each load once the user has applied it and pressed Enter."""
    sensor, readings = SENSORS[name], list[Telemetry]()
    with closing(SerialLink(lambda: open_port(port), on_reading=readings.append)) as link:
        link.start()
        if not link.wait_connected(_CONNECTING):
            raise InputError(f"{port}: {link.status.problem or 'no answer'}")
        for load in known:
            print(f"apply {load:g} {sensor.known_unit}, then Enter: ", end="", flush=True)
            if not sys.stdin.readline():
                raise InputError("calibrate: input ended before the last load")
            readings.clear()
            end = time.monotonic() + _CONNECTING
            while len(readings) < _AVERAGED:
                if time.monotonic() > end:
                    problem = link.status.problem or "timeout"
                    raise InputError(f"calibrate: readings stopped: {problem}")
                time.sleep(0.01)
            values = [sensor.reading(telemetry) for telemetry in readings[:_AVERAGED]]
            mean, scatter = statistics.fmean(values), statistics.stdev(values)
            print(f"  {mean:.5g} {sensor.unit}, scatter {scatter:.2g} {sensor.unit}")
            yield mean, load
