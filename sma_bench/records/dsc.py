"""Runs of differential scanning calorimeters: text exports of PerkinElmer, TA, Netzsch, Mettler and
Setaram, and anybody's table of time, temperature and heat flow.

Titles have units, which TA's Universal Analysis writes as lines `Sig1 ...`; Pyris (PerkinElmer)
writes a block a step under titles ("2) DSC Temperature Scan") whose columns are known. Steps of the
others are cut where the measured rate changes its kind.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.record import FloatArray
from sma_bench.records.roles import Sheet
from sma_bench.records.tables import Account, read_table_file
from sma_bench.records.units import WORDS, parse_unit, plain_title

SegmentKind = Literal["heating", "cooling", "isothermal"]

_BLOCK = re.compile(r"(\d{1,9})\) DSC (Isothermal|Temperature Scan)\s*$")
_STEP = re.compile(
    r"(\d{1,9})\)\s+(?:Hold for .*|(?P<way>Heat|Cool) from .* at "
    r"(?P<rate>\d{1,9}+(?:\.\d*+)?+)\s*+\S?C/min)\s*$"
)
_SIG = re.compile(r"Sig(\d{1,9})\Z")
_RAMP = re.compile(r"Ramp\s++(\d{1,9}+(?:\.\d*+)?+)\s*+\S*C/min", re.IGNORECASE)
_WINDOW = 20.0  # s over which a rate is measured
_SHORTEST = 60.0  # s
_STILL = 0.3  # of the slowest ramp
_Part = tuple[float, slice]
_Block = tuple[int, re.Match[str]]  # row of its first, title


@dataclass(frozen=True)
class DscSegment:
    """One step of a DSC run; the sample's signal is heat_flow - baseline."""

    number: int  # as counted in the file, from 1
    kind: SegmentKind
    rate: float  # programmed, K/s, negative when cooling, 0 when isothermal
    time: FloatArray  # (n,) s since the start of the run
    heat_flow: FloatArray  # (n,) W, unsubtracted, with the file's sign
    baseline: FloatArray  # (n,) W, zeros where the file has none
    temperature: FloatArray  # (n,) K of the sample
    program_temperature: FloatArray  # (n,) K


@dataclass(frozen=True, repr=False)
class DscRecord(Drawn):
    """A differential scanning calorimetry run."""

    path: Path
    mass: float  # of the sample, kg
    header: dict[str, str]  # `key: value` lines before the data, as written
    segments: tuple[DscSegment, ...]  # in order
    findings: tuple[Finding, ...] = ()  # remarks of the reader, a file cut short for instance
    instrument: str = "PerkinElmer Pyris DSC"
    exotherm: str = ""  # "up" or "down" where the file says it
    account: Account | None = None  # what became of the file's rows and columns

    def __repr__(self) -> str:
        return f"<DscRecord {self.path}: {len(self.segments)} segments>"

    @property
    def sample(self) -> str:
        """Name of the sample as written in the file."""
        names = ("Sample ID", "Sample", "Sample Name", "SAMPLE", "IDENTITY")
        return next((self.header[name] for name in names if name in self.header), "")

    def specific_heat_flow(self, segment: DscSegment) -> FloatArray:
        """Heat flow less baseline per mass of sample, (n,) W/kg, with the file's sign."""
        return (segment.heat_flow - segment.baseline) / self.mass

    @property
    def endothermic_up(self) -> bool | None:
        """Whether heat into the sample counts positive; None where the run does not show it.

        Where the file does not say: heating a sample takes heat and cooling it gives heat back, so
        the mean of heat flow less baseline over the heating scans lies on the endothermic side of
        that over the cooling scans.
        """
        if self.exotherm:
            return self.exotherm == "down"
        means = [(s.kind, float(np.mean(s.heat_flow - s.baseline))) for s in self.segments]
        heating, cooling = ([m for k, m in means if k == kind] for kind in ("heating", "cooling"))
        return bool(np.mean(heating) > np.mean(cooling)) if heating and cooling else None


def read_dsc(path: str | Path, stated: Mapping[str, float] | None = None) -> DscRecord:
    """The DSC run in a file; `stated`: what it does not hold in SI units, `mass`. Raises InputError
    where it is not such a file, without a mass, or a line is not what it should be."""
    file = read_table_file(path)
    sheets = [Sheet(file, table, stated or {}) for table in file.tables]
    return dsc_of(next(filter(is_dsc, sheets), sheets[0]))


def is_dsc(sheet: Sheet) -> bool:
    """Whether a table has temperature and heat flow, or is an export that names them elsewhere."""
    texts = [text for _, text in sheet.table.marks] + [" ".join(c) for c in sheet.table.above]
    named = any(_BLOCK.match(text) or text.strip() == "StartOfData" for text in texts)
    return named or sheet.has("dsc", ["time"])


def dsc_of(sheet: Sheet) -> DscRecord:
    """The run in a table that `is_dsc`; raises as `read_dsc`."""
    path, above = sheet.path, [" ".join(cells) for cells in sheet.table.above]
    marks = [(0, text) for text in above] + list(sheet.table.marks)
    header: dict[str, str] = {}
    for cells, text in zip(sheet.table.above, above, strict=True):
        parted = len(cells) > 1 and not any(":" in cell for cell in cells[:3])
        key, colon, value = text.lstrip("# ").partition(f"{cells[0]} " if parted else ":")
        if parted or colon:
            header.setdefault((cells[0] if parted else key).strip(), value.strip())
    for text in sheet.table.left_out:
        sheet.remark("warning", path.name, text)
    blocks = [(row, match) for row, text in marks if (match := _BLOCK.match(text))]
    if blocks:
        sheet = sheet.titled(WORDS["pyris"])
        for column in sheet.table.columns:
            sheet.require_complete(column)
    elif "StartOfData" in above:
        named = {int(m[1]): " ".join(c[1:]) for c in sheet.table.above if (m := _SIG.match(c[0]))}
        if sorted(named) != list(range(1, len(sheet.table.columns) + 1)):
            raise InputError(f"{path}: no Sig1, Sig2, ... lines, expected one for each column")
        sheet = sheet.titled([named[k] for k in sorted(named)])
    columns = sheet.columns("dsc")
    time, temperature, flow = (sheet.values(*column) for column in columns.values())
    kept = time >= 0.0  # TA's rows of negative time separate the steps of a method
    time, temperature, flow = time[kept], temperature[kept], flow[kept]
    back = np.flatnonzero(np.diff(time) < 0.0)
    if len(back):
        line = sheet.table.lines[kept][back[0] + 1]
        raise InputError(f"{path}: line {line}: time runs backward")

    # The mass; heat flow for a gram needs none: one of 1 mg gives the same.
    unit, mass = parse_unit(columns["heat flow"][0].unit), sheet.noted("mass")
    if unit is not None and unit.quantity == "specific power":
        if mass is None:
            mass = 1e-6
            text = "no sample mass; heat flow is for a gram, so 1 mg is taken"
            sheet.remark("warning", "sample mass", text)
        flow = flow * mass
    if mass is None:
        how = "state it, mass=12 mg, or write a line 'Sample Mass: 12 mg'"
        raise InputError(f"{path}: no sample mass above the table: {how} above the titles")
    if not 0.0 < mass < 1e-3:
        raise InputError(f"{path}: sample mass is {mass:g} kg, expected one of milligrams")

    # The steps of the method, each with its rows.
    baseline, program = np.zeros(len(time)), temperature
    if blocks:
        for column in sheet.table.columns:
            if column.title in ("Baseline", "Program Temperature"):
                columns[column.title.lower()] = column, "temperature"
        baseline = sheet.values(columns["baseline"][0], "heat flow")
        program = sheet.values(*columns["program temperature"])
        parts = list(_programmed(path, blocks, above, time, program))
    else:
        ramps = [float(m[1]) / 60.0 for _, text in marks if (m := _RAMP.search(text))]
        parts = list(enumerate(_cut(time, temperature, ramps), 1))
        if not any(rate for _, (rate, _) in parts):
            raise InputError(f"{path}: no heating or cooling in it, expected a DSC scan")
    segments = []
    for number, (rate, part) in parts:
        kind: SegmentKind = "heating" if rate > 0.0 else "cooling" if rate < 0.0 else "isothermal"
        values = (v[part] for v in (time, flow, baseline, temperature, program))
        segments.append(DscSegment(number, kind, rate, *values))
    announced = header.get("Total Points in Run", "")
    if re.fullmatch(r"\d{1,9}", announced) and int(announced) != len(time):
        text = f"{len(time)} points, the header announces {announced}; the file may be cut short"
        sheet.remark("warning", path.name, text, points=len(time))

    # Which way exothermic is.
    lines = [f"{key} {value}" for key, value in header.items() if key.lower().startswith("exo")]
    said = plain_title(" ".join([*lines, columns["heat flow"][0].name]))
    up = re.search(r"exo\w*( direction)? (up|1)\b|\^ ?exo|endo\w* down", said)
    down = re.search(r"exo\w*( direction)? (down|-1)\b|\^ ?endo|endo\w* up", said)
    exotherm = "up" if up else "down" if down else ""
    default = "PerkinElmer Pyris DSC" if blocks else "DSC"
    names = ("Instrument", "INSTRUMENT", "Instrument Type")
    instrument = next((header[name] for name in names if name in header), default)
    account, findings = sheet.account(columns, len(time)), tuple(sheet.findings)
    return DscRecord(path, mass, header, tuple(segments), findings, instrument, exotherm, account)


def _programmed(
    path: Path,
    blocks: Sequence[_Block],
    above: Sequence[str],
    time: FloatArray,
    program: FloatArray,
) -> Iterator[tuple[int, _Part]]:
    """Pyris' segments: number, rate and rows of each; a block under its title, the rate in the
    method above."""
    steps = {int(m[1]): m for line in above if (m := _STEP.match(line.strip()))}
    ends = [row for row, _ in blocks[1:]] + [len(time)]
    for (first, match), last in zip(blocks, ends, strict=True):
        number, rate = int(match[1]), 0.0
        if first == last:
            raise InputError(f"{path}: segment {number} has no data, expected rows")
        duration = time[last - 1] - time[first]
        step = steps.get(number)
        if match[2] != "Isothermal" and step and step["way"]:
            rate = (1.0 if step["way"] == "Heat" else -1.0) * float(step["rate"]) / 60.0
        elif match[2] != "Isothermal" and not step and duration > 0.0:
            rate = float((program[last - 1] - program[first]) / duration)
        yield number, (rate, slice(first, last))


def _cut(time: FloatArray, temperature: FloatArray, ramps: Sequence[float]) -> Iterator[_Part]:
    """Rate and rows of the steps of a run, which is split where the rate, measured over some
    seconds around each row, changes its kind; `ramps`: of the method, K/s."""
    if len(time) < 2:
        return
    period = float(np.median(np.diff(time)))
    half = max(int(round(0.5 * _WINDOW / period)) if period > 0.0 else 3, 1)
    padded = [np.pad(v, half, mode="edge") for v in (time, temperature)]
    spans = [v[2 * half :] - v[: -2 * half] for v in padded]
    rate = spans[1] / np.maximum(spans[0], 1e-9)
    still = _STILL * min(ramps, default=1.0 / 60.0)
    kind = np.where(np.abs(rate) > still, np.sign(rate), 0)
    edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        if time[last - 1] - time[first] < _SHORTEST:
            continue
        # A rate is known to half its window only; the turn itself belongs to neither step.
        begin, end = time[first] + 0.5 * _WINDOW, time[last - 1] - 0.5 * _WINDOW
        part = slice(int(np.searchsorted(time, begin)), int(np.searchsorted(time, end)))
        measured = float(np.median(rate[part])) if kind[first] else 0.0
        nearest = min(ramps, key=lambda ramp: abs(ramp - abs(measured)), default=np.inf)
        if abs(nearest - abs(measured)) < 0.2 * abs(measured):  # the method's own
            measured = float(np.copysign(nearest, measured))
        yield measured, part
