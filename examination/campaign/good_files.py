"""What is read from outside: a good input of each kind, small, and the call that reads it."""

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.hardware.serial_messages import ProtocolError, Splitter, decode, frame, line
from sma_bench.nodes.arguments import check_arguments
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import load_protocol
from sma_bench.protocols.reading import TEMPERATURE, load_reference
from sma_bench.records import open_record, read_record
from sma_bench.report.collected_report import read_result

_PYRIS = """Filename:\tC:\\run.dcd
Sample ID:\tNiTi wire
Sample Weight:\t10.000 mg
1)\tHold for 1.0 min at 100.00\xb0C
2)\tCool from 100.00\xb0C to 70.00\xb0C at 10.00\xb0C/min
1) DSC Isothermal
\tTime     \tUnsubtracted\tBaseline     \tProgram     \tSample     \tApprox.
\t          \tHeat Flow     \tHeat Flow     \tTemperature\tTemperature\tGas Flow
\t0.000000\t10.0\t1.0\t100.0\t99.0\t0.0
2) DSC Temperature Scan
\t1.000000\t5.0\t1.0\t100.0\t99.0\t0.0
\t2.000000\t4.0\t1.0\t90.0\t89.5\t0.0
"""
_TA = """Version\t4.1
Run\t1
Size\t10.0\tmg
ExoDown
Nsig\t3
Sig1\tTime (min)
Sig2\tTemperature (\xb0C)
Sig3\tHeat Flow (mW)
StartOfData
0.0\t20.0\t0.1
0.1\t21.0\t0.2
0.2\t22.0\t0.1
"""
PARAMETERS = """/**:
  ros__parameters:
    wire: {resistance: 2.7, mass: 9.1e-5}
    bench: {channels: [front_1, back_1], channel_sides: [front, back]}
    uncertainty.wire.resistance: 0.03
"""
_PROTOCOL = """name: triangle
description: two of them
repeat: 2
steps:
  - {kind: triangle, name: heat, drive: all, peak: 6.0, rise: 30.0, fall: 30.0}
  - {kind: ramp, start: 0.0, stop: 2.7, duration: 7.0}
  - {kind: rest, duration: 60.0}
"""
_REFERENCE = """name: steps
steps:
  - {kind: hold, level: 330.0, duration: 10.0}
  - {kind: ramp, start: 330.0, stop: 340.0, duration: 7.0}
"""
METADATA = """rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  message_count: 2
  topics_with_message_count:
    - topic_metadata: {name: /bench/wire/power, type: sensor_msgs/msg/BatteryState}
      message_count: 2
  relative_file_paths: [bag.mcap]
"""
MAP: dict[str, Any] = {
    "time": {"time [s]": "s"}, "supply_voltage": 12.0, "lever": 0.1, "ignored": ["x"],
    "signals": [
        {"signal": "wire.voltage", "column": "voltage [V]", "unit": "V", "clock": "time [s]",
         "scale": 1.0, "offset": 0.0, "sign": 1, "reference": "none", "form": "rms"},
        {"signal": "wire.temperature", "column": "temperature [degC]", "unit": "degC",
         "clock": "time [s]", "sign": 1, "reference": "none"},
    ],
}  # fmt: skip
RESULT = {
    "parameters": {
        "wire.resistance": {"value": 2.7, "std": 0.1, "unit": "ohm", "method": "E1", "n": 9}
    },
    "experiments": [
        {"name": "E1", "title": "resistance", "source": "bag", "estimates": {}, "details": {
            "drift": {"value": 0.1, "std": 0.2, "unit": "A"}}}
    ],
    "warnings": ["one"],
}  # fmt: skip
DIAGNOSIS = {
    "verdict": "effect", "cause": ["hysteresis"],
    "where": {
        "stage": "thermal",
        "table": [{"signal": "wire.temperature", "phase": "heating", "side": "front", "gap": 2.0,
                   "share": 0.5, "rms": 1.0}],
        "chain": [{"block": "thermal", "gap": 1.0, "ci90": [0.5, 1.5]}],
    },
    "candidates": [
        {"name": "hysteresis", "stage": "thermal", "probability": 0.9, "gap_over_noise": 1.0,
         "log_evidence": 3.0, "parameters": {"a.b": {"value": 1.0, "std": 0.1, "unit": ""}}}
    ],
    "shrinkage": {
        "wire.temperature": {"rmse_before": 2.0, "rmse_after": 1.0, "noise_floor": 0.5,
                             "fraction": 0.5, "ci90": [0.4, 0.6]}
    },
    "next_experiment": {"why": "to tell them apart"}, "findings": ["one"], "warnings": [],
}  # fmt: skip
_TELEMETRY = b"T 57 3210000 1 0 12003 -102 0 15002 14990 2844 0 0 65535 1"
_SERIAL = (
    b"".join(line(text.decode()) for text in (_TELEMETRY, b"K A 13841", b"N V 6", b"P 3 9 5"))
    + frame(bytes.fromhex("42390010fb30000100e32e9aff00009a3a8e3a1c0b00000000ffff0100"))
    + _TELEMETRY
)


@dataclass(frozen=True)
class Parser:
    """A parser, a good input, and the file name that it goes by."""

    name: str
    good: bytes
    read: Callable[[Path], object]
    file: str = "input.txt"


def _rows(*columns: np.ndarray) -> bytes:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "\n".join("\t".join(f"{number:.4f}" for number in row) for row in rows).encode()


def _node_arguments(file: Path) -> None:
    """A parameter file for a node, and each of its lines as -p name:=value."""
    check_arguments("experiment", ["--ros-args", "--params-file", str(file)])
    for text in file.read_text(encoding="utf-8", errors="replace").splitlines():
        name, _, value = text.strip().partition(": ")
        check_arguments("experiment", ["--ros-args", "-p", f"{name}:={value}"])


def _serial(file: Path) -> None:
    """The stream in pieces, as lines and as frames; then what comes with a right checksum, which is
    not thereby right. A wrong message is a ProtocolError."""
    received = file.read_bytes()
    bodies = received.split(b"\n")
    for binary in (False, True):
        splitter = Splitter()
        splitter.expect(binary)
        for start in range(0, len(received), 13):
            bodies += splitter.feed(received[start : start + 13])
    for body in bodies:
        with contextlib.suppress(ProtocolError):
            decode(body)


def parsers() -> tuple[Parser, ...]:
    """Every parser of what comes from outside; the first four are of instruments."""
    wire = Parameters.defaults()
    heat = np.linspace(20.0, 120.0, 30)
    cycle = np.concatenate([heat, heat[::-1]]), np.linspace(4.0, 0.0, 60), np.full(60, 99.0)
    strain = np.linspace(0.0, 0.02, 40)
    pull = b"Strain (-)\tStress (MPa)\n" + _rows(strain, 22_800.0 * strain)
    return (
        Parser("calorimeter, Pyris", _PYRIS.encode("latin-1"), open_record, "pyris.txt"),
        Parser("calorimeter, TA", _TA.encode(), open_record, "ta.txt"),
        Parser("isobaric test", _rows(*cycle), open_record, "100 MPa.txt"),
        Parser("tensile test", pull, open_record, "tensile.txt"),
        Parser("parameter file", PARAMETERS.encode(), read_parameters),
        Parser("parameters of a node", PARAMETERS.encode(), _node_arguments),
        Parser("protocol", _PROTOCOL.encode(), lambda p: load_protocol(p, wire), "input.yaml"),
        Parser("reference", _REFERENCE.encode(), lambda p: load_reference(p, wire, TEMPERATURE),
               "input.yaml"),
        Parser("metadata of a bag", METADATA.encode(), lambda p: read_record(p.parent),
               "metadata.yaml"),
        Parser("result", json.dumps(RESULT, indent=1).encode(), read_result, "input.json"),
        Parser("serial bytes", _SERIAL, _serial),
    )  # fmt: skip
