"""Runs of differential scanning calorimeters: text exports of PerkinElmer, TA, Netzsch, Mettler and
Setaram, and anybody's table of temperature and heat flow.

Pyris (PerkinElmer) writes a block a step under titles ("2) DSC Temperature Scan"), time [min],
unsubtracted and baseline heat flow [mW], program and sample temperature [degC], gas flow. All
others have titles with units, which TA's Universal Analysis writes as lines `Sig1 ...`; their steps
are cut where the measured rate changes its kind.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.contract import CELSIUS_ZERO
from sma_bench.records.record import FloatArray
from sma_bench.records.roles import Sheet
from sma_bench.records.tables import Account, read_table_file
from sma_bench.records.units import parse_unit, plain_title, split_title

SegmentKind = Literal["heating", "cooling", "isothermal"]

_TITLE = re.compile(r"(\d{1,9})\) DSC (Isothermal|Temperature Scan)\s*$")
_STEP = re.compile(
    r"(\d{1,9})\)\s+"
    r"(?:Hold for .*|(?P<way>Heat|Cool) from .* at (?P<rate>[\d.]++)\s*+\S?C/min)\s*$"
)
_SIGNAL = re.compile(r"Sig(\d{1,9})\Z")
_RAMP = re.compile(r"Ramp\s++(\d{1,9}+(?:\.\d*+)?+)\s*+\S*C/min", re.IGNORECASE)
_WINDOW = 20.0  # s over which a rate is measured
_SHORTEST = 60.0  # s
_STILL = 0.3  # of the slowest ramp
_NO_MASS = (
    "no sample mass above the table: state it, mass=12 mg, or write a line 'Sample Mass: 12 mg' "
    "above the titles"
)


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
        exotherm: "up" or "down" where the file says it, else "".
        account: what became of the file's rows and columns.
    """

    path: Path
    mass: float
    header: dict[str, str]
    segments: tuple[DscSegment, ...]
    findings: tuple[Finding, ...] = ()
    instrument: str = "PerkinElmer Pyris DSC"
    exotherm: str = ""
    account: Account | None = None

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


def read_dsc(path: str | Path, stated: Mapping[str, float] | None = None) -> DscRecord:
    """Read a DSC run.

    Args:
        path: of the file.
        stated: what the file does not hold in SI units: `mass`.

    Raises:
        InputError: not such a file, no sample mass, or a line that is not what it should be.
    """
    file = read_table_file(path)
    sheets = [Sheet(file, table, stated or {}) for table in file.tables]
    chosen = next(filter(is_dsc, sheets), None)
    if chosen is None:
        names = ", ".join(column.name for column in file.columns[:12])
        raise InputError(f"{path}: no columns of temperature and heat flow among {names}")
    return dsc_of(chosen)


def is_dsc(sheet: Sheet) -> bool:
    """Whether a table has temperature and heat flow, or is an export that names them elsewhere."""
    texts = [text for _, text in sheet.table.marks] + [" ".join(c) for c in sheet.table.above]
    if any(_TITLE.match(text) or text.strip() == "StartOfData" for text in texts):
        return True
    return sheet.find("temperature") is not None and sheet.find("heat flow") is not None


def dsc_of(sheet: Sheet) -> DscRecord:
    """The run in a table that `is_dsc`; raises as `read_dsc`."""
    header: dict[str, str] = {}
    for cells in sheet.table.above:
        text = " ".join(cells).lstrip("# ")
        parted = len(cells) > 1 and not any(":" in cell for cell in cells[:3])
        key, colon, value = text.partition(cells[0] + " " if parted else ":")
        if parted or colon:
            header.setdefault(cells[0].strip() if parted else key.strip(), value.strip())
    texts = [" ".join(cells) for cells in sheet.table.above]
    if any(map(_TITLE.match, [*texts, *(text for _, text in sheet.table.marks)])):
        return _pyris(sheet, header, texts)
    if "StartOfData" in texts:
        sheet = _with_signals(sheet)
    findings: list[Finding] = []
    columns = {role: sheet.find(role) for role in ("time", "temperature", "heat flow")}
    for role, found in columns.items():
        if found is None:
            names = ", ".join(column.name for column in sheet.table.columns)
            raise InputError(
                f"{sheet.path}: no column {role!r} with a unit known for it (min, degC, mW or W/g) "
                f"among {names}"
            )
    time, temperature, flow = (sheet.values(f, findings) for f in columns.values() if f)
    kept = time >= 0.0  # TA's rows of negative time separate the steps of a method
    time, temperature, flow = time[kept], temperature[kept], flow[kept]
    if np.any(np.diff(time) < 0.0):
        line = sheet.table.lines[kept][int(np.argmax(np.diff(time) < 0.0)) + 1]
        raise InputError(f"{sheet.path}: line {line}: time runs backward")
    # The mass; heat flow for a gram needs none: one of 1 mg gives the same.
    assert columns["heat flow"] is not None
    unit = parse_unit(columns["heat flow"][0].unit)
    per_mass = unit is not None and unit.quantity == "specific power"
    mass = sheet.noted("mass")
    if mass is None and not per_mass:
        raise InputError(f"{sheet.path}: {_NO_MASS}")
    if mass is None:
        mass = 1e-6
        text = f"{sheet.path}: no sample mass; heat flow is for a gram, so 1 mg is taken"
        findings.append(Finding("warning", "sample mass", text))
    if not 0.0 < mass < 1.0:
        raise InputError(f"{sheet.path}: sample mass is {mass:g} kg, expected one of milligrams")
    ramps = [float(m[1]) for t in texts for m in [_RAMP.search(t)] if m]
    ramps += [float(m[1]) for _, t in sheet.table.marks for m in [_RAMP.search(t)] if m]
    segments = _cut(time, temperature, flow * mass if per_mass else flow, ramps)
    if not any(segment.kind != "isothermal" for segment in segments):
        raise InputError(f"{sheet.path}: no heating or cooling in it, expected a DSC scan")
    # Which way exothermic is.
    title = plain_title(columns["heat flow"][0].name)
    said = " ".join([*(f"{k} {v}" for k, v in header.items() if k.lower().startswith("exo")),
                     title]).lower()  # fmt: skip
    exotherm = ""
    if re.search(r"exo\w*( direction)? (up|1)\b|exo(?:therm\w*)? up|\^ ?exo|endo\w* down", said):
        exotherm = "up"
    elif re.search(r"exo\w*( direction)? (down|-1)\b|exo(?:therm\w*)? down|endo\w* up", said):
        exotherm = "down"
    instrument = next((header[k] for k in ("Instrument", "INSTRUMENT", "Instrument Type")
                       if k in header), "DSC")  # fmt: skip
    used = {found[0].name: role for role, found in columns.items() if found}
    return DscRecord(sheet.path, mass, header, segments, tuple(findings), instrument, exotherm,
                     sheet.account(used, len(time)))  # fmt: skip


def _with_signals(sheet: Sheet) -> Sheet:
    """Universal Analysis' table with the titles of its lines Sig1, Sig2, ..."""
    signals = {int(m[1]): " ".join(cells[1:]) for cells in sheet.table.above
               for m in [_SIGNAL.match(cells[0])] if m}  # fmt: skip
    if sorted(signals) != list(range(1, len(sheet.table.columns) + 1)):
        raise InputError(
            f"{sheet.path}: no Sig1, Sig2, ... lines for {len(sheet.table.columns)} columns, "
            "expected their names"
        )
    columns = []
    for k, column in enumerate(sheet.table.columns, 1):
        title, unit = split_title(signals[k])
        columns.append(replace(column, name=signals[k], title=title, unit=unit))
    return replace(sheet, table=replace(sheet.table, columns=tuple(columns)))


def _cut(
    time: FloatArray, temperature: FloatArray, flow: FloatArray, ramps: Sequence[float]
) -> tuple[DscSegment, ...]:
    """Split a run where the rate, measured over some seconds around each row, changes its kind."""
    if len(time) < 2:
        return ()
    period = float(np.median(np.diff(time)))
    half = max(int(round(0.5 * _WINDOW / period)) if period > 0.0 else 3, 1)
    padded = [np.pad(v, half, mode="edge") for v in (time, temperature)]
    ends = [sliding_window_view(v, 2 * half + 1)[:, [0, -1]] for v in padded]
    rate = (ends[1][:, 1] - ends[1][:, 0]) / np.maximum(ends[0][:, 1] - ends[0][:, 0], 1e-9)
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
        if measured and ramps:  # the method's own, if it is near
            nearest = min(ramps, key=lambda ramp: abs(ramp / 60.0 - abs(measured))) / 60.0
            if abs(nearest - abs(measured)) < 0.2 * abs(measured):
                measured = float(np.copysign(nearest, measured))
        segments.append(_segment(len(segments) + 1, measured, time[part], flow[part],
                                 temperature[part]))  # fmt: skip
    return tuple(segments)


def _segment(
    number: int, rate: float, time: FloatArray, flow: FloatArray, temperature: FloatArray,
    baseline: FloatArray | None = None, program: FloatArray | None = None,
) -> DscSegment:
    kind: SegmentKind = "heating" if rate > 0.0 else "cooling" if rate < 0.0 else "isothermal"
    return DscSegment(
        number, kind, rate, time, flow, np.zeros(len(time)) if baseline is None else baseline,
        temperature, temperature if program is None else program,
    )


def _pyris(sheet: Sheet, header: dict[str, str], above: Sequence[str]) -> DscRecord:
    path, table = sheet.path, sheet.table
    if "Sample Weight" not in header and "mass" not in sheet.given:
        raise InputError(f"{path}: no 'Sample Weight' line, expected a Pyris DSC text export")
    mass = sheet.noted("mass") if "mass" in sheet.given else None
    if mass is None:
        text = header["Sample Weight"]
        weight, _, unit = text.partition(" ")
        mass = float(weight) * 1e-6 if re.fullmatch(r"\d*\.?\d+", weight) else 0.0
        if unit.strip() != "mg" or not 0.0 < mass < 1.0:
            raise InputError(f"{path}: Sample Weight is {text!r}, expected a positive number of mg")
    steps: dict[int, float] = {}
    for line in above:
        if step := _STEP.match(line.strip()):
            sign = {"Heat": 1.0, "Cool": -1.0, None: 0.0}[step["way"]]
            steps[int(step[1])] = sign * float(step["rate"] or "0") / 60.0
    # Blocks begin at their titles.
    marks = [(0, text) for text in above if _TITLE.match(text)]
    marks += [(k, text) for k, text in table.marks if _TITLE.match(text)]
    if len(table.columns) != 6:
        raise InputError(f"{path}: {len(table.columns)} columns, expected 6 numbers a row")
    values = np.column_stack([column.values for column in table.columns])
    wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(wrong):
        line = table.lines[wrong[0]]
        raise InputError(f"{path}: line {line} is not complete, expected 6 numbers")
    segments = []
    ends = [k for k, _ in marks[1:]] + [len(values)]
    for (first, title), last in zip(marks, ends, strict=True):
        match = _TITLE.match(title)
        assert match is not None
        number, rows = int(match[1]), values[first:last]
        if not len(rows):
            raise InputError(f"{path}: segment {number} has no data, expected rows")
        time, program = rows[:, 0] * 60.0, rows[:, 3] + CELSIUS_ZERO
        if np.any(np.diff(time) < 0):
            line = table.lines[first]
            raise InputError(f"{path}: line {line}: time runs backward in segment {number}")
        rate = 0.0 if match[2] == "Isothermal" else steps.get(number, float("nan"))
        if np.isnan(rate):
            duration = time[-1] - time[0]
            rate = float((program[-1] - program[0]) / duration) if duration > 0 else 0.0
        flow, baseline = rows[:, 1] * 1e-3, rows[:, 2] * 1e-3
        temperature = rows[:, 4] + CELSIUS_ZERO
        segments.append(_segment(number, rate, time, flow, temperature, baseline, program))
    findings = [Finding("warning", path.name, text) for text in table.left_out]
    announced = header.get("Total Points in Run", "")
    if re.fullmatch(r"\d{1,9}", announced) and int(announced) != len(values):
        text = (
            f"{len(values)} points, the header announces {announced}; the file may be cut short"
        )
        findings.append(Finding("warning", path.name, text, {"points": len(values)}))
    roles = ("time", "heat flow", "baseline", "program temperature", "temperature", "gas flow")
    used = {c.name: role for c, role in zip(table.columns[:5], roles, strict=False)}
    return DscRecord(path, mass, header, tuple(segments), tuple(findings),
                     account=sheet.account(used, len(values)))  # fmt: skip
