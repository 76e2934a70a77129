"""Reads text exports of TA Instruments' DSCs, such as the paper's Q2000.

Two programs write them. Universal Analysis: `key<TAB>value` lines, `Sig1 ...` naming the columns,
`OrgMethod` naming the steps, `StartOfData`, then rows of all steps in one block. TRIOS:
`key<TAB>value` lines in [sections], then for each step `[step]`, a title, names, units and rows.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.dsc import DscRecord, DscSegment, SegmentKind
from sma_bench.records.text_table import (
    FloatArray,
    head_of,
    name_and_unit,
    plain_unit,
    read_lines,
    read_text_table,
)

_START = "StartOfData"
_STEP = "[step]"
_MASS_KEYS = ("Size", "Sample Mass")
_EXOTHERM_KEYS = ("Exotherm", "Exotherm Direction")
_SIGNAL = re.compile(r"Sig(\d{1,9})\Z")
_RAMP = re.compile(r"Ramp\s++(\d{1,9}+(?:\.\d*+)?+)\s*+\S*C/min", re.IGNORECASE)
_WINDOW = 20.0  # s over which a rate is measured
_SHORTEST = 60.0  # s
_STILL = 0.3  # of the slowest ramp
_MASS_UNITS = {"mg": 1e-6, "g": 1e-3, "ug": 1e-9}


@dataclass(frozen=True)
class TaDscRecord(DscRecord):
    """A run of a TA instrument, whose file says which way exothermic is."""

    @property
    def endothermic_up(self) -> bool | None:
        """Whether heat into the sample counts positive."""
        for key in _EXOTHERM_KEYS:
            direction = self.header.get(key, "").strip().lower()
            if direction in ("up", "down"):
                return direction == "down"
        return super().endothermic_up


@dataclass(frozen=True)
class _Block:
    """Rows under one set of columns: `names`, `units` (k,), `rows` (n, k), first `line`."""

    title: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: FloatArray
    line: int

    def column(self, path: Path, word: str) -> tuple[FloatArray, str]:
        """(n,) values and unit of the first column whose name begins with the word."""
        for i, name in enumerate(self.names):
            if name.lower().startswith(word):
                return self.rows[:, i], plain_unit(self.units[i])
        raise InputError(
            f"{path}: line {self.line}: no column {word!r} among {', '.join(self.names)}"
        )


def is_ta_dsc(path: Path) -> bool:
    """Whether a file looks like a DSC text export of Universal Analysis or TRIOS."""
    head = head_of(path, 65536)
    universal = b"StartOfData" in head and b"Sig1" in head and b"DSC" in head
    return universal or (b"[step]" in head and b"Heat Flow" in head) or _is_plain(path, head)


def _is_plain(path: Path, head: bytes) -> bool:
    """Whether a file is a table with titles of time, temperature and heat flow, and no more."""
    lower = head.lower()
    if not all(word in lower for word in (b"heat", b"flow", b"temp", b"time")):
        return False
    try:
        return _plain_block(path) is not None
    except InputError:
        return False


def _plain_block(path: Path) -> "_Block | None":
    table = read_text_table(path)
    named = [name_and_unit(title) for title in table.titles]
    plain = [(part[0].lower().replace("_", " "), part[1]) if part else ("", "") for part in named]
    names = tuple(name for name, _ in plain)
    wanted = all(any(n.startswith(w) for n in names) for w in ("time", "temperature", "heat flow"))
    units = tuple(unit for _, unit in plain)
    return _Block("", names, units, table.values, int(table.lines[0])) if wanted else None


def _plain_segments(
    path: Path, lines: Sequence[str]
) -> tuple[float, dict[str, str], tuple[DscSegment, ...], tuple[Finding, ...]]:
    """Mass, header, segments and findings of a table with titles. Heat flow for a gram needs no
    mass: one of 1 mg gives the same."""
    block = _plain_block(path)
    if block is None:
        raise InputError(f"{path}: neither {_START} nor {_STEP} in it, expected a TA DSC export")
    header = {key.rstrip(":"): value for key, value in _key_values(lines[: block.line - 1]).items()}
    for line in lines[: block.line - 1]:
        key, colon, value = line.partition(":")
        if colon:
            header.setdefault(key.strip(), value.strip())
    findings: tuple[Finding, ...] = ()
    if not any(key in header for key in _MASS_KEYS) and block.column(path, "heat")[1] == "w/g":
        header["Size"] = "1 mg"
        text = f"{path}: no sample mass; heat flow is for a gram, so 1 mg is taken"
        findings = (Finding("warning", "sample mass", text),)
    mass = _mass(path, header)
    segments, more = _cut(path, block, mass, ())
    return mass, header, segments, (*findings, *more)


def read_ta_dsc(path: str | Path) -> TaDscRecord:
    """Read a DSC text export of Universal Analysis or TRIOS.

    Raises:
        InputError: not such a file, no sample mass, or a line that is not what it should be.
    """
    path = Path(path)
    lines = read_lines(path)
    stripped = [line.strip() for line in lines]
    if _START in stripped:
        header, signals, ramps = _universal_header(stripped)
        block = _universal_block(path, stripped, signals)
        mass = _mass(path, header)
        segments, findings = _cut(path, block, mass, ramps)
    elif _STEP in stripped:
        header = _key_values(stripped[: stripped.index(_STEP)])
        mass = _mass(path, header)
        segments, findings = _trios_segments(path, stripped, mass)
    else:
        mass, header, segments, findings = _plain_segments(path, stripped)
    if not any(segment.kind != "isothermal" for segment in segments):
        raise InputError(f"{path}: no heating or cooling in it, expected a DSC scan")
    if "Sample" in header:
        header.setdefault("Sample ID", header["Sample"])
    elif "Sample Name" in header:
        header.setdefault("Sample ID", header["Sample Name"])
    return TaDscRecord(
        path, mass, header, segments, findings,
        header.get("Instrument") or header.get("Instrument Type") or "TA Instruments DSC",
    )


def _key_values(lines: Sequence[str]) -> dict[str, str]:
    header: dict[str, str] = {}
    for line in lines:
        key, separator, value = line.partition("\t")
        if not separator:
            key, separator, value = line.partition(",")
        if separator:
            header.setdefault(key.strip(), value.strip().replace("\t", " "))
    return header


def _universal_header(
    lines: Sequence[str],
) -> tuple[dict[str, str], dict[int, tuple[str, str]], list[float]]:
    """Header, (name, unit) of each column by number from 1, and the ramps in K/min."""
    above = list(lines[: lines.index(_START)])
    header = _key_values(above)
    signals = {}
    ramps = []
    for line in above:
        key, _, value = line.partition("\t")
        number = _SIGNAL.match(key)
        column = name_and_unit(value)
        if number and column:
            signals[int(number[1])] = column
        ramp = _RAMP.search(value) if key == "OrgMethod" else None
        if ramp:
            ramps.append(float(ramp[1]))
    return header, signals, ramps


def _universal_block(
    path: Path, lines: Sequence[str], signals: dict[int, tuple[str, str]]
) -> _Block:
    if not signals or sorted(signals) != list(range(1, len(signals) + 1)):
        raise InputError(f"{path}: no Sig1, Sig2, ... lines, expected the names of the columns")
    first = lines.index(_START) + 1
    rows = _rows(path, lines, first, len(lines), len(signals))
    # Rows of negative time separate the steps of a method.
    rows = rows[rows[:, 0] >= 0.0] if len(rows) else rows
    if len(rows) < 2:
        raise InputError(f"{path}: line {first + 1}: no rows after {_START}")
    ordered = [signals[k] for k in sorted(signals)]
    return _Block(
        "", tuple(n for n, _ in ordered), tuple(u for _, u in ordered), rows, first + 1
    )


def _rows(path: Path, lines: Sequence[str], first: int, last: int, width: int) -> FloatArray:
    rows = []
    for i in range(first, last):
        if not lines[i]:
            continue
        cells = [cell for cell in re.split(r"[\t,; ]+", lines[i]) if cell]
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            numbers = []
        if len(numbers) != width or not np.all(np.isfinite(numbers)):
            raise InputError(f"{path}: line {i + 1} is {lines[i][:60]!r}, expected {width} numbers")
        rows.append(numbers)
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _mass(path: Path, header: dict[str, str]) -> float:
    for key in _MASS_KEYS:
        words = header.get(key, "").split()
        if not words:
            continue
        try:
            mass = float(words[0]) * _MASS_UNITS[words[1].lower() if len(words) > 1 else "mg"]
        except (ValueError, KeyError):
            mass = 0.0
        if not 0.0 < mass < 1.0:
            raise InputError(f"{path}: {key} is {header[key]!r}, expected a sample mass in mg")
        return mass
    raise InputError(f"{path}: no {' or '.join(_MASS_KEYS)} line, expected the sample's mass")


def _physical(path: Path, block: _Block, mass: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time s, temperature K, heat flow W."""
    time, time_unit = block.column(path, "time")
    temperature, unit = block.column(path, "temperature")
    flow, flow_unit = block.column(path, "heat flow")
    scales = {"mw": 1e-3, "w": 1.0, "uw": 1e-6, "w/g": 1e3 * mass, "mw/mg": 1e3 * mass}
    seconds = {"min": 60.0, "s": 1.0, "sec": 1.0, "h": 3600.0}
    if flow_unit not in scales or time_unit not in seconds or unit not in ("c", "k", "degc"):
        raise InputError(
            f"{path}: line {block.line}: units {', '.join(block.units)}, expected min, degC and "
            "mW or W/g"
        )
    if np.any(np.diff(time) < 0.0):
        raise InputError(f"{path}: line {block.line}: time runs backward")
    kelvin = temperature if unit == "k" else temperature + CELSIUS_ZERO
    return time * seconds[time_unit], kelvin, flow * scales[flow_unit]


def _cut(
    path: Path, block: _Block, mass: float, ramps: Sequence[float]
) -> tuple[tuple[DscSegment, ...], tuple[Finding, ...]]:
    """Split one block of all steps where the measured rate changes its kind."""
    time, temperature, flow = _physical(path, block, mass)
    rate = _measured_rate(time, temperature)
    still = _STILL * min(ramps, default=1.0) / 60.0
    kind = np.where(rate > still, 1, np.where(rate < -still, -1, 0))
    edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    segments: list[DscSegment] = []
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        if time[last - 1] - time[first] < _SHORTEST:
            continue
        # A rate is known to half its window only; the turn itself belongs to neither step.
        begin, end = time[first] + 0.5 * _WINDOW, time[last - 1] - 0.5 * _WINDOW
        part = slice(int(np.searchsorted(time, begin)), int(np.searchsorted(time, end)))
        measured = float(np.median(rate[part])) if kind[first] else 0.0
        segments.append(
            _segment(len(segments) + 1, _programmed(measured, ramps),
                     time[part], temperature[part], flow[part])
        )
    return tuple(segments), ()


def _measured_rate(time: FloatArray, temperature: FloatArray) -> FloatArray:
    """(n,) K/s over some seconds around each row."""
    period = float(np.median(np.diff(time)))
    half = max(int(round(0.5 * _WINDOW / period)) if period > 0.0 else 3, 1)
    padded = [np.pad(v, half, mode="edge") for v in (time, temperature)]
    ends = [sliding_window_view(v, 2 * half + 1)[:, [0, -1]] for v in padded]
    return np.asarray(
        (ends[1][:, 1] - ends[1][:, 0]) / np.maximum(ends[0][:, 1] - ends[0][:, 0], 1e-9)
    )


def _programmed(measured: float, ramps: Sequence[float]) -> float:
    """The method's rate (K/s, signed) nearest to a measured one, if it is near."""
    if not measured or not ramps:
        return measured
    nearest = min(ramps, key=lambda ramp: abs(ramp / 60.0 - abs(measured))) / 60.0
    near = abs(nearest - abs(measured)) < 0.2 * abs(measured)
    return float(np.copysign(nearest if near else abs(measured), measured))


def _segment(
    number: int, rate: float, time: FloatArray, temperature: FloatArray, flow: FloatArray
) -> DscSegment:
    kind: SegmentKind = "heating" if rate > 0.0 else "cooling" if rate < 0.0 else "isothermal"
    return DscSegment(
        number=number, kind=kind, rate=rate, time=time, heat_flow=flow,
        baseline=np.zeros(len(time)), temperature=temperature, program_temperature=temperature,
    )


def _trios_segments(
    path: Path, lines: Sequence[str], mass: float
) -> tuple[tuple[DscSegment, ...], tuple[Finding, ...]]:
    starts = [i for i, line in enumerate(lines) if line == _STEP]
    segments: list[DscSegment] = []
    findings: list[Finding] = []
    for number, (start, stop) in enumerate(
        zip(starts, [*starts[1:], len(lines)], strict=True), start=1
    ):
        block = _trios_block(path, lines, start, stop)
        if len(block.rows) < 2:
            text = f"step {number} ({block.title}) has no rows"
            findings.append(Finding("info", path.name, text))
            continue
        time, temperature, flow = _physical(path, block, mass)
        ramp = _RAMP.search(block.title)
        change = float(temperature[-1] - temperature[0])
        rate = float(np.copysign(float(ramp[1]) / 60.0, change)) if ramp else 0.0
        segments.append(_segment(number, rate, time, temperature, flow))
    return tuple(segments), tuple(findings)


def _trios_block(path: Path, lines: Sequence[str], start: int, stop: int) -> _Block:
    if start + 3 >= stop:
        raise InputError(f"{path}: line {start + 1}: a step without title, columns and units")
    title = lines[start + 1]
    names, units = (
        tuple(cell.strip() for cell in re.split(r"[\t,;]", lines[start + k])) for k in (2, 3)
    )
    if len(names) != len(units):
        raise InputError(
            f"{path}: line {start + 4}: {len(units)} units for {len(names)} columns"
        )
    last = next(
        (i for i in range(start + 4, stop) if not lines[i] or lines[i].startswith("[")), stop
    )
    return _Block(
        title, names, units, _rows(path, lines, start + 4, last, len(names)), start + 3
    )
