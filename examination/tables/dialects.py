"""How people's loggers and machines write one table: drawn habits, and the file they give.

A habit is one value of one feature (`HABITS`); a dialect is a habit of each. It knows whether its
file tells what it means: units, the meaning of every column, and a clock.
"""

import datetime as dt
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from examination.pieces import applies, without_exclusions
from examination.tables.truths import Quantity, Truth
from sma_bench.arrays import Array

PLAIN = 0.93  # probability of a feature's first habit: a file has a few oddities, not all
KNOWN = 0.7  # probability that a file starts from what a user sent (`SEEN`)
START = dt.datetime(2024, 3, 14, 9, 58, 30)

_DATA = yaml.safe_load(Path(__file__).with_name("dialects.yaml").read_text(encoding="utf-8"))
HABITS: dict[str, list[str]] = _DATA["habits"]
_BENCH_SEEN, _MACHINE_SEEN = _DATA["bench_seen"], _DATA["machine_seen"]
_WORDS: dict[str, list[str]] = _DATA["words"]
_STYLES = HABITS["titles"]

_UNITS: dict[str, list[tuple[str, float, float, int]]] = _DATA["units"]
_UNITS["ambient"], _UNITS["extension"] = _UNITS["temperature"], _UNITS["length"]
_NUMBERED = {"s": (1.0, 4), "ms": (1e-3, 0), "min": (60.0, 6), "d": (86400.0, 10)}
_COARSE = ("whole seconds", "whole s", "date and whole s")
_CONVENTIONS: dict[str, Callable[[Array], Array]] = {
    "driven is positive": lambda amperes: amperes,
    "battery's sign": lambda amperes: -amperes,
    "mean of a switched supply": lambda amperes: amperes**2 / max(amperes.max(), 1e-9),
}
_LATE = 0.013  # s, of a sparse last column
_SHIFT = 12.0  # s, between two clocks of a table


class Written(NamedTuple):
    """A column as the file has it: its title, the truth behind it (None: nothing to read), SI in
    one unit of its last decimal."""

    title: str
    quantity: Quantity | None
    step: float = 0.0


class Sample(NamedTuple):
    """One file: where, the habits that made it, its columns, the true times of each
    signal and the finest step of its clock in s, and whether it tells what it means."""

    path: Path
    habits: dict[str, str]
    columns: tuple[Written, ...]
    times: dict[str, Array]
    tick: float
    tells: bool


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
    has_current = any(column.kind == "current" for column in truth.columns)
    of_table = {"kind": truth.kind, "is_bench": truth.is_bench, "has_current": has_current}
    return {**habits, **of_table, "is_extension": truth.is_extension}


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
    columns: list[Written] = []
    units: list[str] = []
    cells: list[list[Any]] = []
    decimals: list[int] = []

    def put(title: str, unit: str, values: list[Any], places: int, of: Quantity | None = None,
            step: float = 0.0) -> None:  # fmt: skip
        columns.append(Written(title, of, step))
        units.append(unit)
        cells.append(values)
        decimals.append(places)

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
        "second thermometer": ("T2", "°C", [21.0 + 0.01 * (k % 7) for k in range(rows)]),
    }
    if habits["beside"] in beside:
        put(*beside[habits["beside"]], 2)
    # Cells that are not there, and rows of the last column alone.
    grid = [[column[k] for column in cells] for k in range(rows)]
    width = len(columns)
    if habits["cells"] == "gaps":
        first = len(clock)
        for row in range(5, rows - 1):
            if rng.random() < 0.05:
                grid[row][int(rng.integers(first, width))] = str(rng.choice(["", "NaN", "---"]))
    if is_sparse:
        last = max(k for k, column in enumerate(columns) if column.quantity)
        for k, row in enumerate(grid):
            empty = range(len(clock), width) if is_late[k] else (last,)
            grid[k] = ["" if c in empty and (c != last or not is_late[k]) else v
                       for c, v in enumerate(row)]  # fmt: skip
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
    tick = 1.0 if habits["time"] in _COARSE else 1e-3
    last_one = truth.columns[-1]
    times = {c.quantity.signal: truth.time for c in columns if c.quantity}
    if habits["time"] == "a clock each" and len(truth.columns) > 1:
        times[last_one.signal] = truth.time + _SHIFT
    if is_sparse:
        times[last_one.signal] = late
    marked = tuple(Written(title, column.quantity, column.step)
                   for title, column in zip(titles[-width:], columns, strict=True))
    held = _about(truth, habits)
    tells = not any(applies(rule, held) for rule in _DATA["untold"])
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
        start = START.replace(tzinfo=dt.UTC).timestamp()
        return [(title, "s", np.round(start + time, 3).tolist(), 3)]
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
