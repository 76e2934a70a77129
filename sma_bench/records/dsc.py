"""Reads the text export of a PerkinElmer Pyris DSC run.

The file is a header of `key: value` lines, the method's steps, then a block a step: a title
("2) DSC Temperature Scan") and rows of time [min], unsubtracted heat flow [mW], baseline heat flow
[mW], program and sample temperature [degC], gas flow; calibration data follow the last block.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import FloatArray
from sma_bench.records.tables import is_text, read_lines
from sma_bench.records.text_table import head_of

SegmentKind = Literal["heating", "cooling", "isothermal"]

_TITLE = re.compile(r"^(\d{1,9})\) DSC (Isothermal|Temperature Scan)\s*$")
_STEP = re.compile(
    r"^(\d{1,9})\)\s+"
    r"(?:Hold for .*|(?P<way>Heat|Cool) from .* at (?P<rate>[\d.]++)\s*+\S?C/min)\s*$"
)
_COLUMNS = 6
_HEADING_WORDS = ("Time", "Heat Flow")
_LARGEST_FILE = 1 << 28


@dataclass(frozen=True)
class DscSegment:
    """One step of a DSC run.

    Attributes:
        number: as counted in the file, from 1.
        kind: heating, cooling or isothermal.
        rate: programmed, K/s, negative when cooling, 0 when isothermal.
        time: (n,) s since the start of the run.
        heat_flow: (n,) W, unsubtracted, with the file's sign.
        baseline: (n,) W, zeros where the file has none; sample signal = heat_flow - baseline.
        temperature: (n,) K of the sample.
        program_temperature: (n,) K.
    """

    number: int
    kind: SegmentKind
    rate: float
    time: FloatArray
    heat_flow: FloatArray
    baseline: FloatArray
    temperature: FloatArray
    program_temperature: FloatArray


@dataclass(frozen=True, repr=False)
class DscRecord(Drawn):
    """A differential scanning calorimetry run.

    Attributes:
        mass: of the sample, kg.
        header: `key: value` lines before the data, as written.
        segments: in order.
        findings: remarks of the reader, a file cut short for instance.
    """

    path: Path
    mass: float
    header: dict[str, str]
    segments: tuple[DscSegment, ...]
    findings: tuple[Finding, ...] = ()
    instrument: str = "PerkinElmer Pyris DSC"

    def __repr__(self) -> str:
        return f"<DscRecord {self.path}: {len(self.segments)} segments>"

    @property
    def sample(self) -> str:
        """Name of the sample as written in the file."""
        return self.header.get("Sample ID", "")

    def specific_heat_flow(self, segment: DscSegment) -> FloatArray:
        """Heat flow less baseline per mass of sample, (n,) W/kg, with the file's sign."""
        return (segment.heat_flow - segment.baseline) / self.mass

    @property
    def endothermic_up(self) -> bool | None:
        """Whether heat into the sample counts positive; None where the run does not show it.

        The file does not say. Heating a sample takes heat and cooling it gives heat back, so the
        mean of heat flow less baseline over the heating scans lies on the endothermic side of that
        over the cooling scans.
        """
        means = {
            kind: [
                float(np.mean(segment.heat_flow - segment.baseline))
                for segment in self.segments
                if segment.kind == kind
            ]
            for kind in ("heating", "cooling")
        }
        if not means["heating"] or not means["cooling"]:
            return None
        return bool(np.mean(means["heating"]) > np.mean(means["cooling"]))


def is_dsc(path: Path) -> bool:
    """Whether a file looks like a Pyris export: its header or a step's title in the beginning."""
    head = head_of(path, 8192)
    return b"Sample Weight:" in head or b") DSC " in head


def read_dsc(path: str | Path) -> DscRecord:
    """Read a Pyris DSC text export.

    Raises:
        InputError: not such a file, or a line that is not what it should be (with its number).
    """
    path = Path(path)
    lines = _lines(path)
    header, steps, first = _read_header(lines)
    mass = _mass(path, header)
    segments, findings = _read_segments(path, lines, first, steps)
    announced = header.get("Total Points in Run", "")
    points = sum(len(segment.time) for segment in segments)
    if re.fullmatch(r"\d{1,9}", announced) and int(announced) != points:
        text = f"{points} points, the header announces {announced}; the file may be cut short"
        findings.append(Finding("warning", path.name, text, {"points": points}))
    return DscRecord(path, mass, header, segments, tuple(findings))


def _lines(path: Path) -> list[str]:
    if not is_text(path):
        return read_lines(path)
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise InputError(f"{path}: too large for a DSC export")
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "latin-1"
    return raw.decode(encoding, errors="replace").replace("\r\n", "\n").split("\n")


def _read_header(lines: list[str]) -> tuple[dict[str, str], dict[int, float], int]:
    """Header fields, the programmed rate in K/s of each step, and the line of the first title."""
    header: dict[str, str] = {}
    steps: dict[int, float] = {}
    for index, line in enumerate(lines):
        if _TITLE.match(line):
            return header, steps, index
        step = _STEP.match(line.strip())
        if step:
            sign = {"Heat": 1.0, "Cool": -1.0, None: 0.0}[step["way"]]
            steps[int(step[1])] = sign * _number(step["rate"] or "0") / 60
            continue
        key, colon, value = line.partition(":")
        if colon:
            # The calibration repeats "Filename"; the run's own comes first.
            header.setdefault(key.strip(), value.strip())
    return header, steps, len(lines)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _mass(path: Path, header: dict[str, str]) -> float:
    text = header.get("Sample Weight")
    if text is None:
        raise InputError(f"{path}: no 'Sample Weight' line, expected a Pyris DSC text export")
    value, _, unit = text.partition(" ")
    mass = _number(value)
    if unit.strip() != "mg" or not 0 < mass < 1e6:
        raise InputError(f"{path}: Sample Weight is {text!r}, expected a positive number of mg")
    return mass * 1e-6


def _read_segments(
    path: Path, lines: list[str], first: int, steps: dict[int, float]
) -> tuple[tuple[DscSegment, ...], list[Finding]]:
    titles = [index for index in range(first, len(lines)) if _TITLE.match(lines[index])]
    if not titles:
        raise InputError(f"{path}: no 'N) DSC ...' block of data, expected a Pyris DSC export")
    findings: list[Finding] = []
    segments = []
    for title, end in zip(titles, [*titles[1:], _end_of_data(lines, titles[-1])], strict=True):
        rows = _rows(path, lines, title + 1, end, findings)
        segments.append(_segment(path, lines[title], title + 1, rows, steps))
    return tuple(segments), findings


def _end_of_data(lines: list[str], last_title: int) -> int:
    """The last block ends at a blank line; calibration data follow."""
    index = last_title + 1
    while index < len(lines) and lines[index].strip():
        index += 1
    return index


def _rows(
    path: Path, lines: list[str], start: int, end: int, findings: list[Finding]
) -> list[list[float]]:
    rows: list[list[float]] = []
    for index in range(start, end):
        line = lines[index]
        if not line.strip() or (not rows and any(word in line for word in _HEADING_WORDS)):
            continue
        cells = [_number(cell) for cell in line.split()]
        if len(cells) == _COLUMNS and all(map(math.isfinite, cells)):
            rows.append(cells)
        elif not any(rest.strip() for rest in lines[index + 1 :]):
            text = f"line {index + 1} is cut short, the file ends inside a row"
            findings.append(Finding("warning", path.name, text))
        else:
            raise InputError(
                f"{path}: line {index + 1} is {line.strip()[:60]!r}, expected {_COLUMNS} numbers"
            )
    return rows


def _segment(
    path: Path, title: str, line: int, rows: list[list[float]], steps: dict[int, float]
) -> DscSegment:
    match = _TITLE.match(title)
    assert match is not None
    number = int(match[1])
    if not rows:
        raise InputError(f"{path}: line {line}: segment {number} has no data, expected rows")
    table = np.array(rows)
    time = table[:, 0] * 60
    if np.any(np.diff(time) < 0):
        raise InputError(f"{path}: line {line}: time runs backward in segment {number}")
    program = table[:, 3] + CELSIUS_ZERO
    rate = 0.0 if match[2] == "Isothermal" else steps.get(number, float("nan"))
    if np.isnan(rate):
        duration = time[-1] - time[0]
        rate = float((program[-1] - program[0]) / duration) if duration > 0 else 0.0
    kind: SegmentKind = "heating" if rate > 0 else "cooling" if rate < 0 else "isothermal"
    return DscSegment(
        number=number,
        kind=kind,
        rate=rate,
        time=time,
        heat_flow=table[:, 1] * 1e-3,
        baseline=table[:, 2] * 1e-3,
        temperature=table[:, 4] + CELSIUS_ZERO,
        program_temperature=program,
    )
