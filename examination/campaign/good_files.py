"""What is read from outside: a good input of each kind, small, and the call that reads it."""

import contextlib
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from sma_bench.hardware.serial_messages import ProtocolError, Splitter, decode, line
from sma_bench.nodes.start import check_arguments
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import TEMPERATURE, load_protocol
from sma_bench.records import open_record, read_record
from sma_bench.report.reports import read_result

FOLDER = Path(__file__).parent / "good"
GOOD = {path.name: path.read_bytes() for path in FOLDER.iterdir()}
RESULT, DIAGNOSIS = (json.loads(GOOD[f"{name}.json"]) for name in ("result", "diagnosis"))
MAP, PARAMETERS, METADATA = (yaml.safe_load(GOOD[f"{name}.yaml"])
                             for name in ("import_map", "parameters", "metadata"))
_TELEMETRY = b"T 57 3210000 1 0 12003 -102 0 15002 14990 2844 0 0 65535 1"
_SERIAL = (
    b"".join(line(text.decode()) for text in (_TELEMETRY, b"K A 13841", b"N V 6", b"P 3 9 5"))
    + bytes.fromhex("0342390410fb30020105e32e9aff01079a3a8e3a1c0b01010104ffff0103615a00")  # COBS
    + _TELEMETRY
)


class Parser(NamedTuple):
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
    heat, strain = np.linspace(20.0, 120.0, 30), np.linspace(0.0, 0.02, 40)
    cycle = np.concatenate([heat, heat[::-1]]), np.linspace(4.0, 0.0, 60), np.full(60, 99.0)
    of_reference = partial(load_protocol, parameters=wire, quantity=TEMPERATURE)
    pull = b"Strain (-)\tStress (MPa)\n" + _rows(strain, 22_800.0 * strain)
    return (
        Parser("calorimeter, Pyris", GOOD["pyris.txt"], open_record, "pyris.txt"),
        Parser("calorimeter, TA", GOOD["ta.txt"], open_record, "ta.txt"),
        Parser("isobaric test", _rows(*cycle), open_record, "100 MPa.txt"),
        Parser("tensile test", pull, open_record, "tensile.txt"),
        Parser("parameter file", GOOD["parameters.yaml"], read_parameters),
        Parser("parameters of a node", GOOD["parameters.yaml"], _node_arguments),
        Parser("protocol", GOOD["protocol.yaml"], lambda p: load_protocol(p, wire), "input.yaml"),
        Parser("reference", GOOD["reference.yaml"], of_reference, "input.yaml"),
        Parser("metadata of a bag", GOOD["metadata.yaml"], lambda p: read_record(p.parent),
               "metadata.yaml"),
        Parser("result", GOOD["result.json"], read_result, "input.json"),
        Parser("serial bytes", _SERIAL, _serial),
    )  # fmt: skip
