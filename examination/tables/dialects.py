"""How people's loggers and machines write one table: drawn habits, and the file they give.

A habit is one value of one feature (`HABITS`); a dialect is a habit of each. It knows whether its
file tells what it means: units, the meaning of every column, and a clock.
"""

import datetime as dt
import re
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from examination.pieces import applies, without_exclusions
from sma_bench.arrays import Array

# --- Forty true tables: bench runs, DSC, isobaric and tensile tests. Synthetic data, in SI units.
TABLES = 40
_DATA = yaml.safe_load(Path(__file__).with_name("dialects.yaml").read_text(encoding="utf-8"))
RIGS = _DATA["rigs"]

# A true column: `signal` of the contract (or of the instrument's record), what it is, its values
# (n,) in SI, how the file writes it (`offset` added, `sign` before).
Quantity = namedtuple("Quantity", "signal kind values offset sign", defaults=(0.0, 1.0))


@dataclass(frozen=True)
class Truth:
    """A true table: `time` (n,) s, its columns, and of DSC the mass in kg."""

    kind: str
    time: Array
    columns: tuple[Quantity, ...]
    mass: float = 0.0

    @property
    def is_bench(self) -> bool:
        """Whether the file is imported; else it is an instrument's, and read as it is."""
        return self.kind in RIGS


def true_table(number: int, seed: int) -> Truth:
    """Table `number` (0 to 39) of a seed."""
    rng = np.random.default_rng([40, seed, number])
    turn, place = divmod(number, len(_DATA["kinds"]))
    kind = _DATA["kinds"][place]
    if kind == "tensile":
        return _tensile(kind, rng, is_extension=turn % 2 == 1)
    return {"dsc": _dsc, "isobaric": _isobaric}.get(kind, _bench)(kind, rng)


def _bench(kind: str, rng: np.random.Generator) -> Truth:
    """A wire that is heated in two or three steps and cools between them."""
    rows, rate = int(rng.integers(90, 260)), float(rng.choice([4.0, 5.0, 10.0, 20.0]))
    time = np.arange(rows) / rate
    drive = np.zeros(rows)
    steps = int(rng.integers(2, 4))
    level = rng.uniform(1.0, 4.0)
    for k in range(steps):
        begin = rows * (0.1 + 0.9 * k / steps)
        on = (np.arange(rows) >= begin) & (np.arange(rows) < begin + 0.5 * rows / steps)
        drive[on] = level * rng.uniform(0.7, 1.0)
    slow = rows / rate * rng.uniform(0.03, 0.08)
    room, gain = rng.uniform(291.0, 300.0), rng.uniform(40.0, 75.0) / level**2
    rise = np.zeros(rows)
    for k in range(1, rows):
        rise[k] = rise[k - 1] + (gain * drive[k] ** 2 - rise[k - 1]) / (slow * rate)
    ohms = rng.uniform(1.5, 6.0)
    moved = -4e-3 * rng.uniform(0.5, 1.5) / (1.0 + np.exp(-(rise - 35.0) / 5.0))
    moved -= moved[0]
    temperature = Quantity("wire.temperature", "temperature", room + rise)
    volts = Quantity("wire.voltage", "voltage", drive)
    amperes = Quantity("wire.current", "current", drive / ohms)
    zero = rng.choice([2e-5, 4e-4, rng.uniform(0.01, 0.04)])
    position = Quantity("elongation", "length", moved, zero, -1.0 if zero < 1e-3 else 1.0)
    force = Quantity("force", "force", 5.0 - 200.0 * moved)
    room_now = Quantity("ambient.temperature", "ambient", room + 0.3 * np.sin(time / time[-1]))
    columns: list[Quantity] = []
    if kind == "clamped":
        columns = [volts, amperes, temperature]
        columns += [room_now] if rng.random() < 0.4 else []
    elif kind == "spring":
        columns = [volts, amperes, position, force]
        columns += [temperature] if rng.random() < 0.5 else []
    elif kind == "duty":
        duty = drive / drive.max() * rng.uniform(0.3, 0.9)
        columns = [temperature, Quantity("wire.voltage", "duty", duty), position]
        columns += [Quantity("wire.current", "current", 12.0 * np.sqrt(duty) / ohms)]
    else:
        back = np.roll(drive, rows // 6)
        tip = 3e-3 * (rise - np.roll(rise, rows // 6)) / rise.max()
        columns = [Quantity("front.voltage", "voltage", drive),
                   Quantity("back.voltage", "voltage", back),
                   Quantity("deflection", "length", tip - tip[0])]  # fmt: skip
    order = rng.permutation(len(columns) - (kind == "duty" and rng.random() < 0.5))
    return Truth(kind, time, tuple(columns[k] for k in order))


def _dsc(kind: str, rng: np.random.Generator) -> Truth:
    """Heating and cooling at one rate, a peak each way."""
    rows, rate = int(rng.integers(200, 320)), 10.0 / 60.0
    turn = int(rows * 0.5)
    step = rng.choice([1.0, 2.0])
    temperature = 253.15 + rate * step * np.minimum(np.arange(rows), 2 * turn - np.arange(rows))
    is_heating = np.arange(rows) < turn
    height = temperature.max() - 253.15
    centre = np.where(is_heating, 253.15 + 0.6 * height, 253.15 + 0.4 * height)
    peak = rng.uniform(0.1, 0.3) * np.exp(-(((temperature - centre) / (0.06 * height)) ** 2))
    flow = np.where(is_heating, 1.0, -1.0) * (0.05 + peak)  # W/g
    mass = float(np.round(rng.uniform(5e-6, 20e-6), 9))
    columns = (Quantity("temperature", "temperature", temperature),
               Quantity("heat_flow", "heat flow", flow * 1e3 * mass))  # fmt: skip
    return Truth(kind, np.arange(rows) * step, columns, mass)


def _isobaric(kind: str, rng: np.random.Generator) -> Truth:
    """A cycle of temperature at one stress."""
    rows = int(rng.integers(160, 300))
    phase = np.abs(1.0 - np.abs(np.linspace(-1.0, 1.0, rows)))
    low, high = rng.uniform(290.0, 300.0), rng.uniform(380.0, 400.0)
    temperature = low + (high - low) * phase
    centre = np.where(np.arange(rows) < rows // 2, 355.0, 335.0)
    strain = 0.005 + 0.03 / (1.0 + np.exp((temperature - centre) / 3.0))
    stress = rng.uniform(50e6, 250e6) * np.ones(rows) * (1.0 + 1e-3 * np.sin(np.arange(rows)))
    columns = (Quantity("temperature", "temperature", temperature),
               Quantity("strain", "strain", strain), Quantity("stress", "stress", stress))
    return Truth(kind, np.arange(rows) * 2.0, columns)


def _tensile(kind: str, rng: np.random.Generator, is_extension: bool) -> Truth:
    """Loading and unloading; half of them as extension and force."""
    rows = int(rng.integers(120, 260))
    strain = 0.012 * np.minimum(np.linspace(0.0, 1.6, rows), np.linspace(1.6, 0.0, rows) + 0.4)
    stress = rng.uniform(30e9, 60e9) * np.minimum(strain, 0.008 + 0.2 * (strain - 0.008))
    if is_extension:
        columns = (Quantity("strain", "extension", 0.06 * strain),
                   Quantity("stress", "force", 1.9635e-7 * stress))  # fmt: skip
    else:
        columns = (Quantity("strain", "strain", strain), Quantity("stress", "stress", stress))
    return Truth(kind, np.arange(rows) * 0.5, columns)


# --- What is written of them.
PLAIN = 0.93  # probability of a feature's first habit: a file has a few oddities, not all
KNOWN = 0.7  # probability that a file starts from what a user sent (`SEEN`)
START = dt.datetime(2024, 3, 14, 9, 58, 30)
EPOCH = START.replace(tzinfo=dt.UTC).timestamp()
HABITS: dict[str, list[str]] = _DATA["habits"]
_BENCH_SEEN, _MACHINE_SEEN = _DATA["bench_seen"], _DATA["machine_seen"]
_WORDS: dict[str, list[str]] = _DATA["words"]
_STYLES = HABITS["titles"]
_UNITS: dict[str, list[tuple[str, float, float, int]]] = _DATA["units"]
_UNITS["ambient"], _UNITS["extension"] = _UNITS["temperature"], _UNITS["length"]
_NUMBERED = {"s": (1.0, 4), "ms": (1e-3, 0), "min": (60.0, 6), "d": (86400.0, 10)}
_CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "driven is positive": lambda amperes: amperes,
    "battery's sign": lambda amperes: -amperes,
    "mean of a switched supply": lambda amperes: amperes**2 / max(amperes.max(), 1e-9)}
_LATE = 0.013  # s, of a sparse last column
_SHIFT = 12.0  # s, between two clocks of a table

# A column as the file has it: its title, the truth behind it (None: nothing to read), SI in one
# unit of its last decimal.
Written = namedtuple("Written", "title quantity step")
# One file: where, the habits that made it, its columns, the true times of each signal, the finest
# step of its clock in s, and whether it tells what it means.
Sample = namedtuple("Sample", "path habits columns times tick tells")


def draw_habits(truth: Truth, rng: np.random.Generator) -> dict[str, str]:
    """A habit of each feature; what cannot be together is made plain."""
    habits = {}
    for feature, known in HABITS.items():
        is_plain = rng.random() < PLAIN
        habits[feature] = known[0] if is_plain else str(rng.choice(known[1:]))
    seen = _BENCH_SEEN if truth.is_bench else _MACHINE_SEEN
    if rng.random() < KNOWN:
        habits |= seen[int(rng.integers(len(seen)))]
    held = without_exclusions(_about(truth, habits), HABITS, _DATA["exclusions"])
    return {feature: held[feature] for feature in habits}


def _about(truth: Truth, habits: dict[str, str]) -> dict[str, Any]:
    """What the rules of dialects.yaml speak of."""
    kinds = {column.kind for column in truth.columns}
    of_table = {"has_current": "current" in kinds, "is_extension": "extension" in kinds}
    return {**habits, "kind": truth.kind, "is_bench": truth.is_bench, **of_table}


def write(truth: Truth, habits: dict[str, str], folder: Path, rng: np.random.Generator) -> Sample:
    """Write the table in a dialect into `folder`."""
    language = _STYLES.index(habits["titles"])
    is_sparse = habits["cells"] == "sparse last"
    late = truth.time[::3] + _LATE if is_sparse else truth.time[:0]
    order = np.argsort(np.concatenate([truth.time, late]), kind="stable")
    time = np.concatenate([truth.time, late])[order]
    is_late, rows = order >= len(truth.time), len(order)
    row_of = np.where(is_late, 3 * (order - len(truth.time)), order)  # of the truth
    scale = HABITS["scale"].index(habits["scale"]) % 4
    parts: list[tuple[Written, str, list[Any], int]] = []  # each with its unit, cells, decimals

    def put(title: str, unit: str, values: list[Any], places: int, of: Quantity | None = None,
            step: float = 0.0) -> None:
        parts.append((Written(title, of, step), unit, values, places))

    # The clock, then the quantities, each as numbers rounded to its decimals.
    clock = _clock(time, habits, language)
    for one in clock:
        put(*one)
    for quantity in truth.columns:
        at = 1 if habits["scale"] == "um alone" and quantity.kind == "length" else scale
        unit, factor, zero, places = _UNITS[quantity.kind][at]
        values = quantity.sign * quantity.values + quantity.offset
        if quantity.kind == "heat flow" and unit == "W/g":
            factor = truth.mass * 1e3
        if quantity.kind == "current":
            values = _CONVENTIONS[habits["current"]](values)
        word = _WORDS[quantity.kind][language]
        if truth.kind == "beam" and quantity.kind == "voltage":
            word = f"{quantity.signal.partition('.')[0]} {word}"
        if habits["beside"] == "crosshead" and quantity.kind == "extension":
            put("Crosshead", unit, np.round((0.2 + 1.8 * values) / factor, places).tolist(), places)
            word = "Extensometer"
        if habits["time"] == "a clock each" and quantity is truth.columns[-1]:
            put(*_clock(time + _SHIFT, habits, language)[0])
        numbers = np.round((values[row_of] - zero) / factor, places).tolist()
        put(word, unit, numbers, places, quantity, factor * 10.0**-places)
    beside: dict[str, tuple[str, str, list[Any]]] = {
        "comment": ("Comment", "", ["" if k % 40 else f"note {k // 40 + 1}" for k in range(rows)]),
        "status": ("Status", "", [float(k > rows // 2) for k in range(rows)]),
        "setpoint": ("Setpoint", "V", [float(k // 50) for k in range(rows)]),
        "second thermometer": ("T2", "°C", [21.0 + 0.01 * (k % 7) for k in range(rows)])}
    if habits["beside"] in beside:
        put(*beside[habits["beside"]], 2)
    # Cells that are not there, and rows of the last column alone.
    columns, units, cells, decimals = zip(*parts, strict=True)
    grid, width = [list(row) for row in zip(*cells, strict=True)], len(columns)
    for row in range(5, rows - 1) if habits["cells"] == "gaps" else ():
        if rng.random() < 0.05:
            grid[row][int(rng.integers(len(clock), width))] = str(rng.choice(["", "NaN", "---"]))
    if is_sparse:
        last = max(k for k, column in enumerate(columns) if column.quantity)
        for k, row in enumerate(grid):
            empty = {*range(len(clock), width)} - {last} if is_late[k] else {last}
            grid[k] = ["" if c in empty else v for c, v in enumerate(row)]
    # Titles, units and numbers as texts.
    texts = [[_text(cell, decimals[k], units[k], habits) for k, cell in enumerate(row)]
             for row in grid]  # fmt: skip
    titles, head = _titles([column.title for column in columns], units, habits)
    if habits["index"] != "none":
        name = {"unnamed": "", "titled": "No."}.get(habits["index"])
        mark = "r" if habits["index"] == "row names" else ""
        texts = [[f"{mark}{k + 1}", *row] for k, row in enumerate(texts)]
        grid = [[row[0], *values] for row, values in zip(texts, grid, strict=True)]
        titles = titles if name is None else [name, *titles]
        head = head if name is None else [["", *row] for row in head]
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
    marked = tuple(Written(title, column.quantity, column.step)
                   for title, column in zip(titles[-width:], columns, strict=True))
    tells = not any(applies(rule, _about(truth, habits)) for rule in _DATA["untold"])
    return Sample(path, habits, marked, times, tick, tells)


def _clock(time: Array, habits: dict[str, str],
           language: int) -> list[tuple[str, str, list[Any], int]]:
    """Columns of the clock: title, unit, cells, decimals."""
    title, how = _WORDS["time"][language], habits["time"]
    unit = {"days": "d", "a clock each": "s"}.get(how, how.removesuffix(", no unit"))
    if unit in _NUMBERED:
        factor, places = _NUMBERED[unit]
        numbers = np.round(time / factor, places).tolist()
        return [(title, "" if how.endswith("no unit") else unit, numbers, places)]
    if how == "whole s":
        return [(title, "s", np.floor(time + 1e-9).tolist(), 0)]
    if how == "epoch":
        return [(title, "s", np.round(EPOCH + time, 3).tolist(), 3)]
    stamps = [START + dt.timedelta(seconds=float(t)) for t in time]

    def written(form: str) -> list[Any]:
        """Moments in a form, whose %f stands for milliseconds."""
        return [s.strftime(form.replace("%f", f"{s.microsecond // 1000:03d}")) for s in stamps]

    day = _DATA["dates"][language]
    dates = (_WORDS["date"][language], "", written(day), 0)
    clocks = {"none": [], "date and time": [dates, (title, "", written("%H:%M:%S.%f"), 0)],
              "date and whole s": [dates, (title, "", written("%H:%M:%S"), 0)],
              "mm:ss": [(title, "", [f"{int(t // 60):02d}:{t % 60:06.3f}" for t in time], 0)]}
    if how in clocks:
        return clocks[how]
    forms = {"AM/PM": "%I:%M:%S.%f %p", "hh:mm:ss": "%H:%M:%S.%f",
             "whole seconds": "%Y-%m-%d %H:%M:%S", "ISO with zone": "%Y-%m-%dT%H:%M:%S.%f+01:00"}
    if how in forms:
        return [(title, "", written(forms[how]), 0)]
    columns = [("Timestamp", "", written(f"{day} %H:%M:%S.%f"), 0)]
    if how == "elapsed and date-time":
        columns.append((title, "s", np.round(time, 4).tolist(), 4))
    return columns


def _text(cell: Any, places: int, unit: str, habits: dict[str, str]) -> str:
    if isinstance(cell, str):
        return cell
    if habits["cells"] == "SI letters" and unit in ("A", "V") and 0.0 < abs(cell) < 1.0:
        text = f"{cell * 1e3:.{max(places - 3, 0) + 1}f}m"
    else:
        text = f"{cell:,.{places}f}"
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
    mass = [("Sample Mass", f"{truth.mass * 1e6:.3f} mg")] if truth.mass else []
    notes = [("Operator", "nobody"), *mass]
    lines = {"key: value": [f"{key}: {value}" for key, value in notes],
             "# lines": [f"# {key} = {value}" for key, value in notes],
             "a sentence": ["Measured on a bench that is not there", ""]}.get(habits["notes"], [])
    if habits["file"].startswith(("mat", "h5")):
        return _write_arrays(habits, titles, head, grid, folder)
    if habits["file"] != "text":
        return _write_workbook(habits, lines, titles, head, texts, grid, folder)
    separator = {"comma": ",", "semicolon": ";", "tab": "\t", "blanks": "   "}[habits["separator"]]

    def joined(row: list[str], quoted: bool) -> str:
        if separator == "   ":
            return separator + separator.join(cell or "-" for cell in row)
        must = habits["thousands"] != "none" or habits["units"] == "comma u"
        return separator.join(f'"{cell}"' if quoted or (must and separator in cell) else cell
                              for cell in row)

    quoted = habits["quotes"] != "none"
    header = [joined(titles, quoted)] + [joined(row, quoted) for row in head]
    header[0] = {"#": "#", "##": "##"}.get(habits["header"], "") + header[0]
    header = [] if habits["header"] == "none" else header
    header += [header[0]] if habits["header"] == "twice" else []
    body = [joined(row, habits["quotes"] == "all") for row in texts]
    half = len(body) // 2
    if habits["blocks"] == "again":
        body = [*body[:half], "", *header, *body[half:]]
    if habits["blocks"] == "footer":
        body += ["", "End of data"]
    text = "\n".join([*lines, *header, *body]) + "\n"
    path = folder / ("run.csv" if separator in ",;" else "run.txt")
    if habits["encoding"] == "mac_roman":
        text = text.replace("²", "2")
    path.write_bytes(text.encode(habits["encoding"], "replace"))
    return path


def _write_arrays(habits: dict[str, str], titles: list[str], head: list[list[str]],
                  grid: list[list[Any]], folder: Path) -> Path:
    """Named arrays with their units beside or within their names, a matrix or a compound table."""
    values, units = np.array(grid, dtype=float), head[0] if head else [""] * len(titles)
    path = folder / f"run.{habits['file'][:3].strip(',')}"
    if habits["file"].startswith("mat"):
        from scipy.io import savemat
        as_names = {"°C": "degC", "%": "pct", "µm": "um", "mm/mm": "ratio", "1": "ratio"}
        names = [re.sub(r"\W", "_", f"{t}_{as_names.get(u, u)}".rstrip("_"), flags=re.ASCII)
                 for t, u in zip(titles, units, strict=True)]  # fmt: skip
        if habits["file"] == "mat" and not {"W/g", "N/mm²"} & set(units):
            savemat(path, dict(zip(names, values.T, strict=True)))
        else:
            texts = {"names": titles, "units": units}
            lists = {key: np.array(some, dtype=object) for key, some in texts.items()}
            savemat(path, {"log": {"data": values, **lists}})
        return path
    import h5py
    with h5py.File(path, "w") as file:
        if habits["file"] == "h5, compound":
            names = [f"{t} [{u}]" if u else t for t, u in zip(titles, units, strict=True)]
            table = np.array([tuple(row) for row in values], dtype=[(n, "f8") for n in names])
            file.create_dataset("log", data=table)
        else:
            for title, unit, column in zip(titles, units, values.T, strict=True):
                file.create_dataset(f"log/{title}", data=column).attrs["unit"] = unit
    return path


def _write_workbook(habits: dict[str, str], lines: list[str], titles: list[str],
                    head: list[list[str]], texts: list[list[str]], grid: list[list[Any]],
                    folder: Path) -> Path:
    from openpyxl import Workbook
    book = Workbook()
    sheet = book.active
    sheet.title = "Data"
    if habits["file"] == "xlsx, notes first":
        sheet.title = "Info"
        sheet.append(["Operator", "nobody"])
        sheet = book.create_sheet("Data")
    is_text = habits["units"] == "in cells" or habits["cells"] == "SI letters"
    sheets = [sheet]
    if habits["file"] == "xlsx, a second sheet":
        sheets.append(book.create_sheet("Data 2"))
    for sheet in sheets:
        top = [[line] for line in lines] + ([] if habits["header"] == "none" else [titles, *head])
        for row in top + (texts if is_text else grid):
            sheet.append([None if cell == "" else cell for cell in row])
    path = folder / "run.xlsx"
    book.save(path)
    return path
