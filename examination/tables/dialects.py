"""Writes a table as the loggers and machines of various labs do, with randomly drawn habits.

A habit is one value of a feature (`HABITS`); a dialect is one habit of each feature. A sample knows
whether its file is complete: units, the meaning of every column, and a clock."""

import datetime as dt
import re
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.signal import lfilter

from examination.pieces import applies, without_exclusions
from sma_bench.arrays import Array

TABLES = 40  # bench runs, DSC, isobaric and tensile tests: synthetic data, in SI units
_DATA = yaml.safe_load(Path(__file__).with_name("dialects.yaml").read_text(encoding="utf-8"))
RIGS, HABITS = _DATA["rigs"], _DATA["habits"]
PLAIN, KNOWN = 0.93, 0.7  # probability of a feature's first habit; of starting from a user's file
START = dt.datetime(2024, 3, 14, 9, 58, 30)
EPOCH = START.replace(tzinfo=dt.UTC).timestamp()
_UNITS: dict[str, list[tuple[str, float, float, int]]] = _DATA["units"]
_UNITS |= {"ambient": _UNITS["temperature"], "extension": _UNITS["length"]}
_NUMBERED = {"s": (1.0, 4), "ms": (1e-3, 0), "min": (60.0, 6), "d": (86400.0, 10)}
_CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "driven is positive": lambda amperes: amperes,
    "battery's sign": lambda amperes: -amperes,
    "mean of a switched supply": lambda amperes: amperes**2 / max(amperes.max(), 1e-9)}
_LATE, _SHIFT = 0.013, 12.0  # s: delay of a sparse last column; offset between two clocks

# A true column: `signal` of the contract (or of the instrument's record), its kind, its values (n,)
# in SI, and how the file writes it (`offset` added, `sign`).
Quantity = namedtuple("Quantity", "signal kind values offset sign", defaults=(0.0, 1.0))
# A column in the file: its title, its true column (None: nothing to read), the size of its last
# decimal in SI.
Written = namedtuple("Written", "title quantity step")
# One file: path, habits, columns, true times of each signal, resolution of its clock in s, and
# whether it states all units, meanings and a clock.
Sample = namedtuple("Sample", "path habits columns times tick tells")


@dataclass(frozen=True)
class Truth:
    """A true table: `time` (n,) s, its columns, and for DSC the mass in kg."""

    kind: str
    time: Array
    columns: tuple[Quantity, ...]
    mass: float = 0.0

    @property
    def is_bench(self) -> bool:
        """True if the file is imported; otherwise it is an instrument file, read directly."""
        return self.kind in RIGS


def true_table(number: int, seed: int) -> Truth:
    """Table `number` (0 to 39) of a seed."""
    rng = np.random.default_rng([40, seed, number])
    turn, place = divmod(number, len(_DATA["kinds"]))
    kind = _DATA["kinds"][place]
    if kind == "tensile":
        return _tensile(rng, is_extension=turn % 2 == 1)
    return {"dsc": _dsc, "isobaric": _isobaric}.get(kind, _bench)(kind, rng)


def _bench(kind: str, rng: np.random.Generator) -> Truth:
    """A wire that is heated in two or three steps, with cooling in between."""
    rows, rate = int(rng.integers(90, 260)), float(rng.choice([4.0, 5.0, 10.0, 20.0]))
    row, drive = np.arange(rows), np.zeros(rows)
    time, steps, level = row / rate, int(rng.integers(2, 4)), rng.uniform(1.0, 4.0)
    for begin in (rows * (0.1 + 0.9 * k / steps) for k in range(steps)):
        drive[(row >= begin) & (row < begin + 0.5 * rows / steps)] = level * rng.uniform(0.7, 1.0)
    slow = rows / rate * rng.uniform(0.03, 0.08) * rate
    room, gain = rng.uniform(291.0, 300.0), rng.uniform(40.0, 75.0) / level**2
    rise = lfilter([1.0 / slow], [1.0, 1.0 / slow - 1.0], gain * drive**2)
    ohms = rng.uniform(1.5, 6.0)
    moved = -4e-3 * rng.uniform(0.5, 1.5) / (1.0 + np.exp(-(rise - 35.0) / 5.0))
    moved -= moved[0]
    temperature = Quantity("wire.temperature", "temperature", room + rise)
    volts = Quantity("wire.voltage", "voltage", drive)
    amperes = Quantity("wire.current", "current", drive / ohms)
    zero = rng.choice([2e-5, 4e-4, rng.uniform(0.01, 0.04)])
    position = Quantity("elongation", "length", moved, zero, -1.0 if zero < 1e-3 else 1.0)
    if kind == "clamped":
        air = Quantity("ambient.temperature", "ambient", room + 0.3 * np.sin(time / time[-1]))
        columns = [volts, amperes, temperature] + [air] * bool(rng.random() < 0.4)
    elif kind == "spring":
        columns = [volts, amperes, position, Quantity("force", "force", 5.0 - 200.0 * moved)]
        columns += [temperature] * bool(rng.random() < 0.5)
    elif kind == "duty":
        duty = drive / drive.max() * rng.uniform(0.3, 0.9)
        columns = [temperature, Quantity("wire.voltage", "duty", duty), position,
                   Quantity("wire.current", "current", 12.0 * np.sqrt(duty) / ohms)]
    else:
        tip = 3e-3 * (rise - np.roll(rise, rows // 6)) / rise.max()
        columns = [Quantity("front.voltage", "voltage", drive),
                   Quantity("back.voltage", "voltage", np.roll(drive, rows // 6)),
                   Quantity("deflection", "length", tip - tip[0])]
    order = rng.permutation(len(columns) - (kind == "duty" and rng.random() < 0.5))
    return Truth(kind, time, tuple(columns[k] for k in order))


def _dsc(kind: str, rng: np.random.Generator) -> Truth:
    """Heating and cooling at the same rate, with one peak each."""
    rows, rate = int(rng.integers(200, 320)), 10.0 / 60.0
    turn, row, step = int(rows * 0.5), np.arange(rows), rng.choice([1.0, 2.0])
    temperature = 253.15 + rate * step * np.minimum(row, 2 * turn - row)
    height = temperature.max() - 253.15
    centre = 253.15 + np.where(row < turn, 0.6, 0.4) * height
    peak = rng.uniform(0.1, 0.3) * np.exp(-(((temperature - centre) / (0.06 * height)) ** 2))
    flow = np.where(row < turn, 1.0, -1.0) * (0.05 + peak)  # W/g
    mass = float(np.round(rng.uniform(5e-6, 20e-6), 9))
    columns = (Quantity("temperature", "temperature", temperature),
               Quantity("heat_flow", "heat flow", flow * 1e3 * mass))
    return Truth(kind, row * step, columns, mass)


def _isobaric(kind: str, rng: np.random.Generator) -> Truth:
    """A temperature cycle at one stress."""
    rows = int(rng.integers(160, 300))
    row, phase = np.arange(rows), np.abs(1.0 - np.abs(np.linspace(-1.0, 1.0, rows)))
    low, high = rng.uniform(290.0, 300.0), rng.uniform(380.0, 400.0)
    temperature = low + (high - low) * phase
    centre = np.where(row < rows // 2, 355.0, 335.0)
    strain = 0.005 + 0.03 / (1.0 + np.exp((temperature - centre) / 3.0))
    stress = rng.uniform(50e6, 250e6) * (1.0 + 1e-3 * np.sin(row))
    named = {"temperature": temperature, "strain": strain, "stress": stress}
    return Truth(kind, row * 2.0, tuple(Quantity(n, n, values) for n, values in named.items()))


def _tensile(rng: np.random.Generator, is_extension: bool) -> Truth:
    """Loading and unloading, as stress and strain or as force and extension."""
    rows = int(rng.integers(120, 260))
    strain = 0.012 * np.minimum(np.linspace(0.0, 1.6, rows), np.linspace(1.6, 0.0, rows) + 0.4)
    stress = rng.uniform(30e9, 60e9) * np.minimum(strain, 0.008 + 0.2 * (strain - 0.008))
    columns = (Quantity("strain", "strain", strain), Quantity("stress", "stress", stress))
    if is_extension:
        columns = (Quantity("strain", "extension", 0.06 * strain),
                   Quantity("stress", "force", 1.9635e-7 * stress))
    return Truth("tensile", np.arange(rows) * 0.5, columns)


def draw_habits(truth: Truth, rng: np.random.Generator) -> dict[str, str]:
    """A habit of each feature, without excluded combinations."""
    habits = {feature: known[0] if rng.random() < PLAIN else str(rng.choice(known[1:]))
              for feature, known in HABITS.items()}
    seen = _DATA["bench_seen" if truth.is_bench else "machine_seen"]
    if rng.random() < KNOWN:
        habits |= seen[int(rng.integers(len(seen)))]
    held = without_exclusions(_about(truth, habits), HABITS, _DATA["exclusions"])
    return {feature: held[feature] for feature in habits}


def _about(truth: Truth, habits: dict[str, str]) -> dict[str, Any]:
    """Properties that the rules of dialects.yaml refer to."""
    kinds = {column.kind for column in truth.columns}
    return {**habits, "kind": truth.kind, "is_bench": truth.is_bench,
            "has_current": "current" in kinds, "is_extension": "extension" in kinds}


def write(truth: Truth, habits: dict[str, str], folder: Path, rng: np.random.Generator) -> Sample:
    """Write the table in a dialect into `folder`."""
    language, is_sparse = HABITS["titles"].index(habits["titles"]), habits["cells"] == "sparse last"
    late = truth.time[::3] + _LATE if is_sparse else truth.time[:0]
    both = np.concatenate([truth.time, late])
    order = np.argsort(both, kind="stable")
    is_late, rows = order >= len(truth.time), len(order)
    row_of = np.where(is_late, 3 * (order - len(truth.time)), order)  # row of the true table
    clock = _clock(both[order], habits, language)
    # Columns with unit, cells and decimals.
    parts = [(Written(title, None, 0.0), *rest) for title, *rest in clock]
    for quantity in truth.columns:
        kind, scale = quantity.kind, HABITS["scale"].index(habits["scale"]) % 4
        at = 1 if habits["scale"] == "um alone" and kind == "length" else scale
        unit, factor, zero, places = _UNITS[kind][at]
        factor = truth.mass * 1e3 if unit == "W/g" else factor
        values = quantity.sign * quantity.values + quantity.offset
        values = _CONVENTIONS[habits["current"]](values) if kind == "current" else values
        word = _DATA["words"][kind][language]
        if truth.kind == "beam" and kind == "voltage":
            word = f"{quantity.signal.partition('.')[0]} {word}"
        if habits["beside"] == "crosshead" and kind == "extension":
            away = np.round((0.2 + 1.8 * values) / factor, places).tolist()
            parts.append((Written("Crosshead", None, 0.0), unit, away, places))
            word = "Extensometer"
        if habits["time"] == "a clock each" and quantity is truth.columns[-1]:
            title, *rest = _clock(both[order] + _SHIFT, habits, language)[0]
            parts.append((Written(title, None, 0.0), *rest))
        numbers = np.round((values[row_of] - zero) / factor, places).tolist()
        parts.append((Written(word, quantity, factor * 10.0**-places), unit, numbers, places))
    beside: dict[str, tuple[str, str, list[Any]]] = {
        "comment": ("Comment", "", ["" if k % 40 else f"note {k // 40 + 1}" for k in range(rows)]),
        "status": ("Status", "", [float(k > rows // 2) for k in range(rows)]),
        "setpoint": ("Setpoint", "V", [float(k // 50) for k in range(rows)]),
        "second thermometer": ("T2", "°C", [21.0 + 0.01 * (k % 7) for k in range(rows)])}
    if habits["beside"] in beside:
        title, unit, values = beside[habits["beside"]]
        parts.append((Written(title, None, 0.0), unit, values, 2))
    # Missing cells, and rows with the last column only.
    columns, units, cells, decimals = zip(*parts, strict=True)
    grid, width = [list(row) for row in zip(*cells, strict=True)], len(columns)
    for row in range(5, rows - 1) if habits["cells"] == "gaps" else ():
        if rng.random() < 0.05:
            grid[row][int(rng.integers(len(clock), width))] = str(rng.choice(["", "NaN", "---"]))
    last = max(k for k, column in enumerate(columns) if column.quantity)
    for k, row in enumerate(grid if is_sparse else ()):
        empty = {*range(len(clock), width)} - {last} if is_late[k] else {last}
        grid[k] = ["" if c in empty else v for c, v in enumerate(row)]
    # Titles, units and numbers as text.
    texts = [[_text(*cell, habits) for cell in zip(row, decimals, units, strict=True)]
             for row in grid]
    titles, head = _titles([column.title for column in columns], units, habits)
    if habits["index"] != "none":
        name = {"unnamed": [""], "titled": ["No."]}.get(habits["index"], [])
        mark = "r" if habits["index"] == "row names" else ""
        texts = [[f"{mark}{k + 1}", *row] for k, row in enumerate(texts)]
        grid = [[row[0], *values] for row, values in zip(texts, grid, strict=True)]
        titles, head = [*name, *titles], [[*[""] * len(name), *row] for row in head]
    if habits["cells"] == "surplus separators":
        texts = [[*row, ""] for row in texts]
    if habits["cells"] == "surplus comment":
        texts = [[*row, "here"] if k in (30, 60) else row for k, row in enumerate(texts)]
    path = _write_file(truth, habits, titles, head, texts, grid, folder)
    tick = 1.0 if habits["time"] in ("whole seconds", "whole s", "date and whole s") else 1e-3
    times = {c.quantity.signal: truth.time for c in columns if c.quantity}
    if habits["time"] == "a clock each" and len(truth.columns) > 1:
        times[truth.columns[-1].signal] = truth.time + _SHIFT
    if is_sparse:
        times[truth.columns[-1].signal] = late
    marked = tuple(column._replace(title=title)
                   for title, column in zip(titles[-width:], columns, strict=True))
    tells = not any(applies(rule, _about(truth, habits)) for rule in _DATA["untold"])
    return Sample(path, habits, marked, times, tick, tells)


def _clock(time: Array, habits: dict[str, str],
           language: int) -> list[tuple[str, str, list[Any], int]]:
    """Time columns: title, unit, cells, decimals."""
    title, how, day = _DATA["words"]["time"][language], habits["time"], _DATA["dates"][language]
    unit = {"days": "d", "a clock each": "s"}.get(how, how.removesuffix(", no unit"))
    if unit in _NUMBERED:
        factor, places = _NUMBERED[unit]
        shown = "" if how.endswith("no unit") else unit
        return [(title, shown, np.round(time / factor, places).tolist(), places)]
    if how == "whole s":
        return [(title, "s", np.floor(time + 1e-9).tolist(), 0)]
    if how == "epoch":
        return [(title, "s", np.round(EPOCH + time, 3).tolist(), 3)]
    if how == "mm:ss":
        return [(title, "", [f"{int(t // 60):02d}:{t % 60:06.3f}" for t in time], 0)]
    stamps = [START + dt.timedelta(seconds=float(t)) for t in time]

    def written(form: str, title: str = title) -> tuple[str, str, list[Any], int]:
        """Times of day in a format, in which %f stands for milliseconds."""
        forms = (form.replace("%f", f"{s.microsecond // 1000:03d}") for s in stamps)
        return title, "", [s.strftime(f) for s, f in zip(stamps, forms, strict=True)], 0

    forms = {"AM/PM": "%I:%M:%S.%f %p", "hh:mm:ss": "%H:%M:%S.%f", "date and time": "%H:%M:%S.%f",
             "date and whole s": "%H:%M:%S", "whole seconds": "%Y-%m-%d %H:%M:%S",
             "ISO with zone": "%Y-%m-%dT%H:%M:%S.%f+01:00"}
    date = [written(day, _DATA["words"]["date"][language])] * how.startswith("date and ")
    if how in forms or how == "none":
        return [*date, written(forms[how])] if how in forms else []
    elapsed = [(title, "s", np.round(time, 4).tolist(), 4)] * (how == "elapsed and date-time")
    return [written(f"{day} %H:%M:%S.%f", "Timestamp"), *elapsed]


def _text(cell: Any, places: int, unit: str, habits: dict[str, str]) -> str:
    if isinstance(cell, str):
        return cell
    text = f"{cell:,.{places}f}"
    if habits["cells"] == "SI letters" and unit in ("A", "V") and 0.0 < abs(cell) < 1.0:
        text = f"{cell * 1e3:.{max(places - 3, 0) + 1}f}m"
    point = "," if habits["decimal"] == "comma" else "."
    group = {"none": "", "blank": "\u00a0", "sign": "." if point == "," else ","}
    text = text.translate({ord(","): group[habits["thousands"]], ord("."): point})
    return f"{text} {unit}" if habits["units"] == "in cells" and unit not in ("", "1") else text


def _titles(names: list[str], units: list[str],
            habits: dict[str, str]) -> tuple[list[str], list[list[str]]]:
    """Titles, and the rows of units below them."""
    how = habits["units"]
    if habits["separator"] == "blanks":
        names = [name.replace(" ", "_") for name in names]
    if how == "not of T":
        units = ["" if u in ("°C", "degC", "C", "K") else u for u in units]
    if form := _DATA["unit_forms"].get(how):
        return names, [[form.format(u) if u else "" for u in units]]
    if form := _DATA["title_forms"].get(how):
        names = [form.format(n, u) if u else n for n, u in zip(names, units, strict=True)]
    return names, []


def _write_file(truth: Truth, habits: dict[str, str], titles: list[str], head: list[list[str]],
                texts: list[list[str]], grid: list[list[Any]], folder: Path) -> Path:
    notes = {"Operator": "nobody"}
    notes |= {"Sample Mass": f"{truth.mass * 1e6:.3f} mg"} if truth.mass else {}
    lines = {"key: value": [f"{key}: {value}" for key, value in notes.items()],
             "# lines": [f"# {key} = {value}" for key, value in notes.items()],
             "a sentence": ["Measured on a bench that is not there", ""]}.get(habits["notes"], [])
    if habits["file"].startswith(("mat", "h5")):
        return _write_arrays(habits["file"], titles, head, grid, folder)
    if habits["file"] != "text":
        is_text = habits["units"] == "in cells" or habits["cells"] == "SI letters"
        top = [] if habits["header"] == "none" else [titles, *head]
        rows = [*([line] for line in lines), *top, *(texts if is_text else grid)]
        return _write_workbook(habits["file"], rows, folder / "run.xlsx")
    separator = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": "   "}[habits["separator"]]
    must = habits["thousands"] != "none" or habits["units"] == "comma u"

    def joined(row: list[str], quoted: bool) -> str:
        if separator == "   ":
            return separator + separator.join(cell or "-" for cell in row)
        return separator.join(f'"{cell}"' if quoted or (must and separator in cell) else cell
                              for cell in row)

    header = [joined(row, habits["quotes"] != "none") for row in (titles, *head)]
    header[0] = {"#": "#", "##": "##"}.get(habits["header"], "") + header[0]
    header = {"none": [], "twice": [*header, header[0]]}.get(habits["header"], header)
    body = [joined(row, habits["quotes"] == "all") for row in texts]
    half = len(body) // 2
    if habits["blocks"] == "again":
        body = [*body[:half], "", *header, *body[half:]]
    body += ["", "End of data"] * (habits["blocks"] == "footer")
    text = "\n".join([*lines, *header, *body]) + "\n"
    text = text.replace("²", "2") if habits["encoding"] == "mac_roman" else text
    path = folder / ("run.csv" if separator in ",;" else "run.txt")
    path.write_bytes(text.encode(habits["encoding"], "replace"))
    return path


def _write_arrays(form: str, titles: list[str], head: list[list[str]], grid: list[list[Any]],
                  folder: Path) -> Path:
    """Write named arrays with units beside or in their names, a matrix, or a compound table."""
    values, units = np.array(grid, dtype=float), head[0] if head else [""] * len(titles)
    path = folder / f"run.{form[:3].strip(',')}"
    if form.startswith("mat"):
        from scipy.io import savemat
        log: dict[str, Any] = {"data": values}
        log |= {key: np.array(texts, dtype=object) for key, texts in (("names", titles),
                                                                     ("units", units))}
        if form == "mat" and not {"W/g", "N/mm²"} & set(units):
            as_names = {"°C": "degC", "%": "pct", "µm": "um", "mm/mm": "ratio", "1": "ratio"}
            names = [re.sub(r"\W", "_", f"{t}_{as_names.get(u, u)}".rstrip("_"), flags=re.ASCII)
                     for t, u in zip(titles, units, strict=True)]
            savemat(path, dict(zip(names, values.T, strict=True)))
        else:
            savemat(path, {"log": log})
        return path
    import h5py
    with h5py.File(path, "w") as file:
        if form == "h5, compound":
            names = [f"{t} [{u}]" if u else t for t, u in zip(titles, units, strict=True)]
            kinds = [(name, "f8") for name in names]
            file.create_dataset("log", data=np.array([tuple(row) for row in values], dtype=kinds))
        else:
            for title, unit, column in zip(titles, units, values.T, strict=True):
                file.create_dataset(f"log/{title}", data=column).attrs["unit"] = unit
    return path


def _write_workbook(form: str, rows: list[list[Any]], path: Path) -> Path:
    from openpyxl import Workbook
    book = Workbook()
    book.active.title = "Data"
    if form == "xlsx, notes first":
        book.active.title = "Info"
        book.active.append(["Operator", "nobody"])
        book.create_sheet("Data")
    if form == "xlsx, a second sheet":
        book.create_sheet("Data 2")
    for sheet in (sheet for sheet in book if sheet.title != "Info"):
        for row in rows:
            sheet.append([None if cell == "" else cell for cell in row])
    book.save(path)
    return path
