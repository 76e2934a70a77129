"""Reads files of calorimeters (PerkinElmer, TA, Netzsch, Mettler, Setaram, or any table of time,
temperature and heat flow), isobaric tests (cycled temperature at one stress) and tensile tests.

TA's Universal Analysis writes titles as lines `Sig1 ...`; Pyris (PerkinElmer) writes a block for
each step, "2) DSC Temperature Scan", of known columns. Other runs are cut where the rate turns."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.findings import Finding, Severity
from sma_bench.records import cells, instruments
from sma_bench.records.cells import PATTERNS, QUANTITIES, WORDS, parse_unit, plain_title
from sma_bench.records.instruments import DscRecord, DscSegment, IsobaricRecord, TensileRecord
from sma_bench.records.tables import Account, Column, Table, TableFile

_WINDOW, _SHORTEST = 20.0, 60.0  # s, over which a rate is measured; shortest step
_STILL = 0.3 / 60.0  # K/s: a lower rate is isothermal
_CONSTANCY = 0.05  # of the stress: largest deviation in an isobaric test
_LARGEST_MASS, _HOTTEST = 1e-3, 1500.0  # kg, K
_LARGEST_SPAN = 0.12  # NiTi single crystals recover some 10 %: a larger strain is in percent
_EXPANSION = 4e-3  # strain: more than metal expands by heat
_WARMING = 4.0  # times the smallest cycle: at varying stress, a smaller one is self-heating
_COLDEST = (-150.0, 60.0)  # degC, of a cycle: warmer values may be K or degF
_LARGEST = {"strain": 0.5, "stress": 3e9}  # of a tensile test, in SI units


def _clauses(cells: Sequence[str]) -> list[str]:
    """A line's statements, each a key with its number: gauge length 60 mm, diameter 0.5 mm."""
    found: list[str] = []
    for part in (part for cell in cells for part in re.split(r"[,;]\s+(?=[^\W\d])", cell)):
        if not found or re.match(r"[^\W\d]{3,}[^\d]*\s.*\d", part):
            found.append(part)
        else:
            found[-1] += (" " if ":" in found[-1] or len(cells) != 2 else ": ") + part
    return found


@dataclass(frozen=True)
class Sheet:
    """One table of an instrument's file."""

    file: TableFile
    table: Table
    given: Mapping[str, float]  # stated by the user, in SI
    findings: list[Finding] = field(default_factory=list)

    @property
    def titles(self) -> str:
        """Names of the columns, for a message; "" if none has a title."""
        named = any(column.title for column in self.table.columns)
        return ", ".join(column.name for column in self.table.columns[:12]) if named else ""

    def remark(self, severity: Severity, subject: str, key: str, **values: Any) -> None:
        """Add a finding: a sentence of words.yaml and the numbers in it."""
        numbers = {name: float(v) for name, v in values.items() if not isinstance(v, str)}
        text = f"{self.file.path}: {cells.message(key, **values)}"
        self.findings.append(Finding(severity, subject, text, numbers))

    def refusal(self, key: str, **values: Any) -> InputError:
        return InputError(f"{self.file.path}: {cells.message(key, **values)}")

    def find(self, *roles: str) -> tuple[Column, str] | None:
        """The best column for the first of these roles that has any, and the role."""
        found = ((self.ranked(role), role) for role in roles)
        return next(((ranked[0][1], role) for ranked, role in found if ranked), None)

    def ranked(self, role: str) -> list[tuple[int, Column]]:
        """Columns that may have a role, with scores, the best first."""
        row, is_flow, found = QUANTITIES[role], role == "heat flow", []
        for column in self.table.columns:
            plain, unit = plain_title(column.title), parse_unit(column.unit)
            meant = cells.meanings(column.title, column.unit)
            if meant in (("setpoint",), ("ambient",)) and "temp" in plain:
                meant = ("temperature",)  # used if there is no better one
            fits = unit.quantity in row["units"] if unit else not (column.unit or is_flow)
            words = set(re.findall(r"[a-z]+", plain))
            fits = fits and not words & set(row.get("never", ()))
            if role in meant and fits and (is_flow or cells.title_meanings(column.title)):
                better, worse = (sum(w in words or (len(w) > 3 and w in plain)
                                     for w in row.get(key, ())) for key in ("better", "worse"))
                found.append((better - 2 * worse, column))
        return sorted(found, key=lambda pair: -pair[0])

    def lacks(self, kind: str, beside: Sequence[str] = ()) -> list[str]:
        """Columns that a kind of test needs (`instruments` in words.yaml) and the table lacks."""
        roles = WORDS["instruments"][kind].items()
        return [what for what, names in roles if what not in beside and not self.find(*names)]

    def columns(self, kind: str, beside: Sequence[str] = ()) -> dict[str, tuple[Column, str]]:
        """Columns of a kind of test, each with its role. InputError: one or most rows missing."""
        rows, fewest = len(self.table.lines), instruments.FEWEST_ROWS
        if kind != "dsc" and rows < fewest:
            raise self.refusal("few_rows", rows=rows, fewest=fewest)
        for lacked in self.lacks(kind, beside):
            title = f"{lacked.capitalize()} ({QUANTITIES[lacked]['example']})"
            raise self.refusal("no_column", what=lacked, titles=self.titles or "none", title=title)
        found = {what: self.find(*roles) for what, roles in WORDS["instruments"][kind].items()}
        chosen = {what: column for what, column in found.items() if column}
        for c in self.table.columns:  # 1, 1, 2, 2 in a column of ids: several specimens
            known, meant = parse_unit(c.unit), cells.title_meanings(c.title)
            if known and meant == ("temperature",) and known.quantity != meant[0]:
                unit, quantity = c.unit, known.quantity
                raise self.refusal("other_unit", unit=unit, quantity=quantity, meaning=meant[0])
            is_id = set(cells.words_of(c.title)) <= {*WORDS["specimens"], "id", "no", "nr"}
            count = len(np.unique(c.values[np.isfinite(c.values)]))
            if is_id and c.title and 1 < count == 1 + np.count_nonzero(np.diff(c.values)):
                raise self.refusal("specimens", count=f"{count}", name=c.name)
        for what, (column, role) in chosen.items():
            (best, _), *others = self.ranked(role)
            alike = (c.name for score, c in others if score == best and _differ(column, c))
            if other := next(alike, ""):
                self.remark("warning", what, "or_another", name=column.name, other=other)
        return chosen

    def with_signals(self) -> "Sheet":
        """The table with the titles of TA's lines `Sig1 ...`, if it has them."""
        signals = [(PATTERNS.sig.match(line[0]), line) for line in self.table.above if line]
        named = {int(found[1]): " ".join(line[1:]) for found, line in signals if found}
        return self.titled([named[k] for k in sorted(named)]) if named else self

    def titled(self, names: Sequence[str]) -> "Sheet":
        columns = self.table.columns
        if len(names) != len(columns):
            raise self.refusal("titles", columns=len(columns), titles=len(names))
        parted = zip(columns, names, map(cells.split_title, names), strict=True)
        named = (replace(c, name=name, title=t, unit=unit) for c, name, (t, unit) in parted)
        return replace(self, table=replace(self.table, columns=tuple(named)))

    def values(self, column: Column, role: str) -> Array:
        """(n,) in SI units. InputError: a cell is missing, or the column has no unit."""
        for missing in np.flatnonzero(~np.isfinite(column.values))[:1]:
            raise self.refusal("no_number", line=self.table.lines[missing], name=column.name)
        unit = parse_unit(column.unit)
        if unit is None:
            title = f"{column.title} ({QUANTITIES[role]['example']})"
            raise self.refusal("unit_of", name=column.name, span=column.span, title=title)
        return unit.si(column.values)

    def noted(self, name: str) -> float | None:
        """A number of `stated` in words.yaml, in SI, if the user or a line states it. InputError:
        lines that differ."""
        if name in self.given:
            return self.given[name]
        found = self.statements(name)
        for first, second in pairwise(found.values()):
            raise self.refusal("several", what=name, first=first[:40], second=second[:40])
        return next(iter(found), None)

    def statements(self, name: str) -> dict[float, str]:
        """The values that lines of text state for a number, each with its first line; lines with a
        `worse` word (a room's temperature) count only if there are no others."""
        row = {"other": WORDS["other_number"]} | (WORDS["stated"] | WORDS["of_rows"])[name]
        found = dict[float, str]()
        lines = [*self.table.above, *([text] for _, text in self.table.marks)]

        def mentions(text: str, key: str) -> bool:
            words = "|".join(map(re.escape, row.get(key, ())))
            return bool(words and re.search(rf"(?<![a-z])(?:{words})", plain_title(text)))

        for text in (clause.lstrip("#% ") for line in lines for clause in _clauses(line)):
            value = cells.number_with_unit(text, row["quantity"])
            is_other = mentions(text, "never") or mentions(re.split(r"\d", text)[0], "other")
            is_meant = mentions(text, "words") or re.search(row.get("form", "$^"), text)
            if value and is_meant and not is_other:
                found.setdefault(value, text)
        return {v: t for v, t in found.items() if not mentions(t, "worse")} or found

    def section(self) -> float | None:
        """Cross-section of the specimen in m2, as stated, or of wires of a diameter that share the
        force; None if unknown."""
        if (area := self.noted("area")) is not None:
            return area
        diameter, (count, line) = self.noted("diameter"), self.wires()
        if line and diameter is not None:
            self.remark("warning", "force", "shared", count=f"{count}", line=line)
        return None if diameter is None else 0.25 * np.pi * diameter**2 * count

    def wires(self) -> tuple[int, str]:
        """How many wires a line states, and that line; 1 and "" without."""
        found = map(PATTERNS.wires.match, map(plain_title, map(" ".join, self.table.above)))
        return next(((int(f[f.lastindex or 0]), f[0]) for f in found if f), (1, ""))

    def account(self, columns: dict[str, tuple[Column, str]], rows: int) -> Account:
        used = {column.name: role for column, role in columns.values()}
        return self.file.account([self.table], rows, used, {"": "not needed"})

    def is_driven(self) -> bool:
        """True if a title means a duty, voltage or current: a record of a bench."""
        named = (c for c in self.table.columns if cells.title_meanings(c.title))
        known = [cells.meanings(c.title, c.unit) for c in named if c.unit or len(c.title) > 1]
        return any((drive,) in known for drive in ("duty", "current", "voltage", "supply"))


def dsc_of(sheet: Sheet) -> DscRecord | None:
    """The DSC run in a table of temperature and heat flow, or of Pyris or Universal Analysis."""
    path, above = sheet.file.path, [" ".join(line) for line in sheet.table.above]
    marks = [(0, text) for text in above] + list(sheet.table.marks)
    is_named = any(PATTERNS.block.match(text) or text.strip() == "StartOfData" for _, text in marks)
    if not is_named and sheet.lacks("dsc", ["time"]):
        return None
    header: dict[str, str] = {}
    for line, text in zip(sheet.table.above, above, strict=True):
        parted = len(line) > 1 and not any(":" in cell for cell in line[:3])
        key, colon, value = text.lstrip("# ").partition(f"{line[0]} " if parted else ":")
        if parted or colon:
            header.setdefault((line[0] if parted else key).strip(), value.strip())
    for text in sheet.table.left_out:
        sheet.remark("warning", path.name, "left_out", text=text)
    blocks = [(row, match) for row, text in marks if (match := PATTERNS.block.match(text))]
    if blocks:
        sheet = sheet.titled(WORDS["pyris"])
        is_complete = np.isfinite([c.values for c in sheet.table.columns]).all(axis=0)
        for row in np.flatnonzero(~is_complete)[:1]:
            raise sheet.refusal("no_number", line=sheet.table.lines[row], name="one of its columns")
    columns = sheet.columns("dsc")
    time, temperature, flow = (sheet.values(*column) for column in columns.values())
    kept = time >= 0.0  # TA's rows of negative time separate the steps of a method
    time, temperature, flow = time[kept], temperature[kept], flow[kept]
    for back in np.flatnonzero(np.diff(time) < 0.0)[:1]:
        raise sheet.refusal("time_back", line=sheet.table.lines[kept][back + 1])
    # Heat flow per gram does not need the mass: any, such as 1 mg, gives the same result.
    unit = parse_unit(columns["heat flow"][0].unit)
    is_specific = unit is not None and unit.quantity == "specific power"
    is_open = "mass" not in sheet.given and len(sheet.statements("mass")) > 1
    mass = None if is_specific and is_open else sheet.noted("mass")
    if mass is None:
        if not is_specific:
            raise sheet.refusal("no_mass")
        mass = 1e-6
        sheet.remark("warning", "sample mass", "for_a_gram")
    flow = flow * mass if is_specific else flow
    if not 0.0 < mass < _LARGEST_MASS:
        raise sheet.refusal("mass", mass=mass)
    baseline, program, parts = np.zeros(len(time)), temperature, list[tuple[int, float, slice]]()
    if blocks:
        roles = {"Baseline": "heat flow", "Program Temperature": "temperature"}
        columns |= {c.title.lower(): (c, roles[c.title]) for c in sheet.table.columns
                    if c.title in roles}
        baseline = sheet.values(*columns["baseline"])
        program = sheet.values(*columns["program temperature"])
        ends = [row for row, _ in blocks[1:]] + [len(time)]
        for (first, match), last in zip(blocks, ends, strict=True):
            number, duration, rate = int(match[1]), float(time[last - 1] - time[first]), 0.0
            if first == last:
                raise sheet.refusal("no_segment", number=number)
            if match[2] != "Isothermal" and duration > 0.0:  # programmed in K/min, three decimals
                rate = round(60.0 * float(program[last - 1] - program[first]) / duration, 3) / 60.0
            parts.append((number, rate, slice(first, last)))
    else:
        parts = _cut(time, temperature)
        if not any(rate for _, rate, _ in parts):
            raise sheet.refusal("no_scan")
    series = time, flow, baseline, temperature, program
    segments = tuple(DscSegment(n, rate, *(v[part] for v in series)) for n, rate, part in parts)
    announced = header.get("Total Points in Run", "")
    if re.fullmatch(r"\d{1,9}", announced) and int(announced) != len(time):
        sheet.remark("warning", path.name, "cut_short", points=len(time), announced=announced)
    lines = [" ".join(re.split(r"[:\s]+", text.lstrip("# "))) for text in above]
    lines = [text for text in lines if text.lower().startswith(("exo", "endo"))]
    text = plain_title(" ".join([*lines, columns["heat flow"][0].name]))
    exotherm = next((way for way, words in WORDS["exotherm"].items() if re.search(words, text)), "")
    names = [n for n in ("Instrument", "INSTRUMENT", "Instrument Type") if n in header]
    instrument = header[names[0]] if names else "PerkinElmer Pyris DSC" if blocks else "DSC"
    account, findings = sheet.account(columns, len(time)), tuple(sheet.findings)
    return DscRecord(path, mass, header, segments, findings, instrument, exotherm, account)


def _cut(time: Array, temperature: Array) -> list[tuple[int, float, slice]]:
    """Number, measured rate (K/s) and rows of each step."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    half = max(int(round(0.5 * _WINDOW / period)) if period > 0.0 else 3, 1)
    padded = [np.pad(v, half, mode="edge") for v in (time, temperature)]
    spans = [v[2 * half :] - v[: -2 * half] for v in padded]
    rate = spans[1] / np.maximum(spans[0], 1e-9)
    kind = np.where(np.abs(rate) > _STILL, np.sign(rate), 0)
    edges = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    parts = list[tuple[int, float, slice]]()
    for first, last in pairwise(edges):
        if time[last - 1] - time[first] < _SHORTEST:
            continue
        # Half a window at either end is left out: the rate there is of both steps.
        begin, end = time[first] + 0.5 * _WINDOW, time[last - 1] - 0.5 * _WINDOW
        part = slice(int(np.searchsorted(time, begin)), int(np.searchsorted(time, end)))
        measured = float(np.median(rate[part])) if kind[first] else 0.0
        parts.append((len(parts) + 1, measured, part))
    return parts


def is_isobaric(sheet: Sheet) -> bool:
    """True if a table has a changing temperature, a strain or extension and a load; without titles,
    if the first column goes up and down and the last of three is constant, or the load stated."""
    columns, has_load = sheet.table.columns, _has_load(sheet)
    if sheet.titles:
        found, loaded = sheet.find("temperature"), sheet.find("stress", "force")
        if found is None or sheet.lacks("isobaric", ["stress"] if has_load else []):
            return False
        least = instruments.SMALLEST_RANGE * (_WARMING if loaded and not _held(loaded[0]) else 1.0)
        return float(np.ptp(found[0].values)) > least and not sheet.is_driven()
    if len(columns) != (2 if has_load else 3) or len(columns[0].values) < 2:
        return False
    steps, held = np.diff(columns[0].values), has_load or _held(columns[-1])
    both_ways = steps.max() > 0.0 > steps.min()
    return bool(held and both_ways and np.ptp(columns[0].values) > instruments.SMALLEST_RANGE)


def _held(column: Column) -> bool:
    """True if most values of a load are within 20 % of their median."""
    values = np.abs(column.values[np.isfinite(column.values)])
    level = float(np.median(values)) if len(values) else np.nan
    return bool(np.sum(np.abs(values - level) < 0.2 * level) > 0.5 * len(values))


def _differ(one: Column, other: Column) -> bool:
    """True unless two columns hold the same numbers, perhaps in different units."""
    there = np.isfinite(one.values) & np.isfinite(other.values)
    both = one.values[there], other.values[there]
    if not there.any():
        return True
    if one.unit == other.unit or min(map(np.ptp, both), default=0.0) == 0.0:
        return not np.allclose(*both, rtol=1e-3, atol=1e-3 * float(np.ptp(both[0])))
    return bool(np.corrcoef(*both)[0, 1] < 0.9999)


def _has_load(sheet: Sheet) -> bool:
    """True if a load is stated, by the user, in a line of text or in the name of the sheet."""
    if cells.number_with_unit(sheet.table.name, "stress") is not None:
        return True
    names = ("stress", "force") if sheet.titles else ("stress",)
    return any(name in sheet.given or sheet.statements(name) for name in names)


def isobaric_of(sheet: Sheet) -> IsobaricRecord | None:
    """The test in a table, None if not `is_isobaric`; without titles in degC, strain and MPa."""
    if not is_isobaric(sheet):
        return None
    path, table, has_load = sheet.file.path, sheet.table, _has_load(sheet)
    if not sheet.titles:  # those of the known form, if the values fit its units
        coldest = float(np.nanquantile(table.columns[0].values, 0.05))
        if not _COLDEST[0] < coldest < _COLDEST[1]:
            raise sheet.refusal("celsius", coldest=coldest)
        level = 0.0 if has_load else float(np.nanmedian(table.columns[-1].values))
        if 1e6 * level >= instruments.STRONGEST:
            raise sheet.refusal("megapascal", level=level)
        titles = ["temperature [degC]", "strain", "stress [MPa]"]
        sheet = sheet.titled(titles[: len(table.columns)])
    columns = sheet.columns("isobaric", ["stress"] if has_load else [])
    pulled, role = columns["strain"]
    span, unit = float(np.ptp(pulled.values)), pulled.unit
    if span == 0.0:
        raise sheet.refusal("constant", what=pulled.name, value=pulled.values[0])
    if role == "strain" and not unit and 0.01 * _LARGEST_SPAN < span < 100.0 * _LARGEST_SPAN:
        unit = "%" if span > _LARGEST_SPAN else "mm/mm"
        sheet.remark("warning", "strain unit", "strain_unit", span=span, unit=unit)
        pulled = replace(pulled, unit=unit)
    temperature, strain = sheet.values(*columns["temperature"]), sheet.values(pulled, role)
    loaded = columns.get("stress")
    section = sheet.section() if loaded and loaded[1] == "force" else 1.0
    if loaded and section is not None:
        stress = sheet.values(*loaded) / section
    else:
        load = sheet.noted("stress") or cells.number_with_unit(table.name, "stress")
        if not load and (section := sheet.section()) is None:
            raise sheet.refusal("no_section", name=loaded[0].name if loaded else "a line")
        stress = np.full(len(strain), load or (sheet.noted("force") or 0.0) / (section or 1.0))
    span = float(np.ptp(strain))
    gauge = sheet.noted("gauge_length") if role == "length" else None
    is_relative = role == "length" and gauge is None
    if is_relative:
        sheet.remark("warning", "strain", "relative", name=pulled.name, extension_range=span,
                     millimetres=f"{span * 1e3:.4g}")
    elif gauge is not None:
        strain = strain / gauge
    elif span > _LARGEST_SPAN:
        sheet.remark("warning", "strain unit", "percent", span=span, unit=unit, most=_LARGEST_SPAN)
    for k in np.flatnonzero((temperature <= 0.0) | (temperature > _HOTTEST))[:1]:
        raise sheet.refusal("temperature", line=table.lines[k], value=temperature[k], most=_HOTTEST)
    # Keep the rows between loading and unloading, where the stress is constant.
    level = float(np.median(stress))
    if level < 0.0:
        raise sheet.refusal("compressed", level=f"{level / 1e6:.4g}")
    away = np.abs(stress - level) > max(_CONSTANCY * abs(level), 1e6)
    inside = np.flatnonzero(~away)
    if len(inside) < 0.5 * len(stress):
        low, high = np.quantile(stress, [0.05, 0.95]) / 1e6
        raise sheet.refusal("levels", low=low, high=high)
    held = slice(int(inside[0]), int(inside[-1]) + 1)
    if rows := len(stress) - (held.stop - held.start):
        sheet.remark("info", "stress", "loading", rows=rows)
    share, level_MPa = float(np.mean(away[held])), f"{level / 1e6:.4g}"
    if share > 0.02:
        sheet.remark("warning", "stress", "not_isobaric", share=share, level=level_MPa)
    temperature, strain, stress = temperature[held], strain[held], stress[held]
    is_hot = temperature > np.median(temperature)
    if strain[is_hot].mean() - strain[~is_hot].mean() > _EXPANSION and not is_relative:
        sheet.remark("warning", "strain", "contracts", name=pulled.name)
        strain = -strain
    if is_relative:
        strain = (strain - strain.min()) / np.ptp(strain)
    good, spikes = instruments.without_spikes(temperature)
    if count := len(spikes):
        of, most = f"{len(temperature)}", f"{np.abs(spikes).max():.1f}"
        sheet.remark("info", "temperature", "spikes", count=count, of=of, most=most)
    settled, noise, rows = instruments.without_noise(temperature[good])
    if noise >= instruments.NOISY:
        sheet.remark("info", "temperature", "noise", noise=noise, rows=rows)
    cycles, remarks = instruments.find_cycles(settled, strain[good], stress[good], str(path))
    median = float(np.median(stress))
    if median > instruments.STRONGEST:
        shown, most = (f"{pascal / 1e6:.0f}" for pascal in (median, instruments.STRONGEST))
        sheet.remark("warning", "stress", "strongest", stress=median, shown=shown, most=most)
    name = f"{path.parent.name}/{path.stem}".lstrip("/")
    name += f"/{table.name}" if len(sheet.file.tables) > 1 else ""
    account, unit = sheet.account(columns, int(np.sum(good))), "relative" if is_relative else "1"
    return IsobaricRecord(path, name, median, unit, cycles, (*sheet.findings, *remarks), account)


def tensile_of(sheet: Sheet) -> TensileRecord | None:
    """The test in a table of strain or extension and stress or force; None if it has a drive."""
    if sheet.lacks("tensile") or sheet.is_driven():
        return None
    table, columns = sheet.table, sheet.columns("tensile")
    pulled, loaded = columns["strain"], columns["stress"]
    strain, stress = sheet.values(*pulled), sheet.values(*loaded)
    # Strain is extension since the first row over gauge length, stress is force over section.
    length = sheet.noted("gauge_length") if pulled[1] == "length" else 1.0
    section = sheet.section() if loaded[1] == "force" else 1.0
    if pulled[1] == "length":
        start = float(strain[0])
        if abs(start) > 0.01 * float(np.ptp(strain)):
            name, at = pulled[0].name, f"{start * 1e3:.6g}"
            sheet.remark("info", "extension", "begins", name=name, start=start, at=at)
        strain = strain - start
    strain, stress = strain / (length or 1.0), stress / (section or 1.0)
    for what, values in (("strain", strain), ("stress", stress)):
        worst, most = int(np.argmax(np.abs(values))), _LARGEST[what]
        if abs(values[worst]) > most:
            line, value = table.lines[worst], values[worst]
            raise sheet.refusal("too_large", line=line, what=what, value=value, most=most)
        if np.ptp(values) == 0.0:
            raise sheet.refusal("constant", what=what, value=values[0])
    if (level := float(np.median(stress))) < 0.0 and section:
        raise sheet.refusal("compressed", level=f"{level / 1e6:.4g}")
    measured = None if "temperature" in sheet.given else sheet.find("temperature")
    if measured is None:
        temperature = sheet.noted("temperature")
    else:
        kelvin, most = sheet.values(*measured), instruments.STEADY
        columns["temperature"] = measured
        if np.ptp(kelvin) > most:
            sheet.remark("warning", "temperature", "unsteady", span=np.ptp(kelvin), most=most)
        temperature = float(np.median(kelvin))
    noted = [m[1].lower() for c in table.above if (m := PATTERNS.phase.search(" ".join(c)))]
    phase = next((phase for phase in instruments.PHASES if phase in noted[:1]), None)
    account, findings = sheet.account(columns, len(strain)), tuple(sheet.findings)
    return TensileRecord(sheet.file.path, strain, stress, temperature, findings, phase,
                         length is None, section is None, account)
