"""Are tables of other loggers read right, asked about or refused, and never silently wrong?

Forty true tables (synthetic data) are written in random dialects, each imported as a user would do
it, and the result is compared with the truth.

    ./bench check tables --imports 4000 --seed 2 --json result.json
"""

import contextlib
import io
import re
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import sma_bench
from examination.pieces import judged
from examination.tables import dialects
from examination.tables.dialects import HABITS, Sample, Truth, Written
from sma_bench.cli import main as run

# Outcomes of an import. Right: every value and time within the resolution of the file, every column
# and sheet used or named. Asked: a question in the map or the error. Refused: a reason, exit code
# 2. Wrong: exit code 0 with other values, times or rows than the file, or a column silently left
# out. Else raised.
OUTCOMES = RIGHT, ASKED, REFUSED, WRONG, RAISED = "right", "asked", "refused", "wrong", "raised"
_ENOUGH = 0.7  # of an instrument's rows; readers leave out reversals and rests
_MOST_LINE = 300
_ADVICE = r"\b(expected|write|quote|give|states?|which)\b"  # a refusal must say what to do


def outcome(truth: Truth, sample: Sample) -> tuple[str, str]:
    try:
        return _imported(truth, sample) if truth.is_bench else _opened(truth, sample)
    except Exception:
        return RAISED, traceback.format_exc()[-_MOST_LINE:]


def _imported(truth: Truth, sample: Sample) -> tuple[str, str]:
    folder = sample.path.parent
    rig, bag, said = folder / "rig.yaml", folder / "bag", io.StringIO()
    rig.write_text(yaml.safe_dump({"/**": {"ros__parameters": dialects.RIGS[truth.kind]}}))
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        status = run(["import", str(sample.path), "--params", str(rig), "--out", str(bag)])
    text = said.getvalue()
    line = " ".join(line for line in text.splitlines() if line.strip())[-_MOST_LINE:]
    maps = "\n".join(path.read_text() for path in folder.glob("*.map.yaml"))
    if status == 2:
        asks = "unsure of" in text or ": ask" in maps or '"ask"' in maps
        return ASKED if asks else REFUSED if re.search(_ADVICE, text) else RAISED, line
    if status != 0:
        return RAISED, f"exit {status}: {line}"
    bags = [bag] if (bag / "metadata.yaml").exists() else sorted(bag.iterdir())
    record, said_of, faults = sma_bench.load(bags[0]), text + maps, []
    for column in sample.columns:
        title, quantity = column.title, column.quantity
        if quantity is None:
            others = title.startswith(("Comment", "Status", "T2"))
            faults += [f"{title}: vanished"] if others and title not in said_of else []
        elif (signal := record.get(quantity.signal)) is not None:
            fault = _signal_fault(truth, sample, column, signal)
            faults += [f"{title}: {fault}"] if fault else []
        elif title not in said_of:
            faults.append(f"{title}: vanished")
        elif quantity.signal != "ambient.temperature":
            faults.append(f"{title}: not read, though named")
    known = {"ambient.temperature", *(column.signal for column in truth.columns)}
    faults += [f"{name}: a signal of nothing" for name in sorted(set(record.signals) - known)]
    if sample.habits["file"] == "xlsx, a second sheet" and len(bags) < 2 and "Data 2" not in text:
        faults.append("sheet Data 2: vanished")
    return (WRONG, "; ".join(faults)) if faults else (RIGHT, "")


def _signal_fault(truth: Truth, sample: Sample, column: Written, signal: Any) -> str:
    """What is wrong with a signal, "" if nothing."""
    quantity, step = column.quantity, column.step
    time, values = np.asarray(signal.time), np.asarray(signal.values, dtype=float)
    if quantity.kind == "duty":  # read as direct voltage
        values, step = (values / 12.0) ** 2, 2.0 * step
    if quantity.kind == "current" and sample.habits["cells"] == "SI letters":
        step = max(step, 1e-4)
    expected = sample.times[quantity.signal]
    true = quantity.values[::3] if len(expected) < len(quantity.values) else quantity.values
    # At most a tenth of the rows may be missing, because of random gaps.
    rows = len(expected)
    fewest = 0.88 * rows if sample.habits["cells"] == "gaps" else rows
    if not fewest <= len(time) <= rows:
        return f"{len(time)} samples of {rows}"
    nearest = np.arange(rows)
    if len(time) < rows:
        nearest = np.abs(time[:, None] - expected[None, :]).argmin(axis=1)
    late = np.abs(time - expected[nearest]).max()
    if late > (1.05 if sample.tick >= 1.0 else max(sample.tick, 1e-4 * np.ptp(truth.time))):
        return f"times off by {late:.3g} s"
    error = np.abs(values - true[nearest]).max()
    loose = 2.2 if quantity.signal in ("elongation", "deflection") else 1.2  # a zero was subtracted
    limit = loose * 0.5 * step + 1e-6 * np.abs(true).max()
    return "" if error <= limit else f"values off by {error:.3g}, written to {step:.3g}"


def _opened(truth: Truth, sample: Sample) -> tuple[str, str]:
    try:
        record: Any = sma_bench.load(sample.path)
    except sma_bench.InputError as error:
        line = str(error)
        asks = "which one" in line or "state" in line
        end = ASKED if asks else REFUSED if re.search(_ADVICE, line) else RAISED
        return end, line[:_MOST_LINE]
    kind = type(record).__name__.removesuffix("Record").lower()
    if kind != truth.kind:
        return WRONG, f"read as {kind or 'a run'}"
    if sample.habits["file"] == "xlsx, a second sheet" and "Data 2" not in str(record.findings):
        return WRONG, "sheet Data 2: vanished"
    # Read values, true values, and the resolution of the file.
    by_name = {c.quantity.signal: c for c in sample.columns if c.quantity}
    true = {c.signal: c.values for c in truth.columns}
    steps = {name: c.step for name, c in by_name.items()}
    if kind == "dsc":
        per_gram = sample.habits["scale"] == "other" and sample.habits["notes"] != "key: value"
        if abs(record.mass - truth.mass) > 1e-9 and not per_gram:
            return WRONG, f"mass {record.mass:.4g} kg of {truth.mass:.4g}"
        true, steps = {"time": truth.time} | true, {"time": 1e-3} | steps
        got = {n: np.concatenate([getattr(s, n) for s in record.segments]) for n in true}
        if per_gram:  # no mass is stated: heat flow per assumed mass
            got["heat_flow"] = got["heat_flow"] * truth.mass / record.mass
        if got["time"][-1] > truth.time[-1] + 1.0:  # absolute times of day, or since the epoch
            got["time"] = got["time"] - dialects.EPOCH
    elif kind == "isobaric":
        parts = [branch for cycle in record.cycles for branch in cycle.branches]
        got = {name: np.concatenate([getattr(part, name) for part in parts]) for name in by_name}
    else:
        kinds = by_name["strain"].quantity.kind, by_name["stress"].quantity.kind
        if (record.is_extension, record.is_force) != (kinds[0] == "extension", kinds[1] == "force"):
            return WRONG, "extension or force taken for strain or stress, or the other way"
        got = {"strain": record.strain - record.strain[0] + true["strain"][0],
               "stress": record.stress}
    # Every row read is a true one in all columns, and enough rows were read.
    count, read = len(next(iter(true.values()))), len(next(iter(got.values())))
    if read < _ENOUGH * count:
        return WRONG, f"{read} rows of {count}"
    worst = np.zeros((read, count))
    for name, values in got.items():
        limit = 0.6 * steps[name] * (2.0 if name == "strain" else 1.0)
        limit += 1e-6 * float(np.abs(true[name]).max()) + (0.01 if name == "time" else 0.0)
        worst = np.maximum(worst, np.abs(values[:, None] - true[name][None, :]) / limit)
    away = int((worst.min(axis=1) > 1.0).sum())
    return (WRONG, f"{away} rows of {read} are none of the file's") if away else (RIGHT, "")


def main(argv: Sequence[str] | None = None) -> int:
    """Write, import, compare; 0 if nothing was silently wrong, 1 if something was."""
    found = judged("tables", __doc__, argv, "imports", imported, OUTCOMES, HABITS)
    telling, others = ([o["outcome"] for o in found if o["tells"] is t] for t in (True, False))
    if telling:
        read = telling.count(RIGHT) / len(telling)
        print(f"of those that tell, read without a question {read:.1%}")
    if others:
        stopped = sum(end in (ASKED, REFUSED) for end in others) / len(others)
        guessed = others.count(RIGHT) / len(others)
        print(f"of those that do not, asked or refused {stopped:.1%}, guessed right {guessed:.1%}")
    return int(any(one["outcome"] in (WRONG, RAISED) for one in found))


def imported(seed: int, number: int) -> dict[str, Any]:
    """Write and import a table."""
    truth = dialects.true_table(number % dialects.TABLES, seed)
    rng = np.random.default_rng([41, seed, number])
    habits = dialects.draw_habits(truth, rng)
    with tempfile.TemporaryDirectory() as folder:
        sample = dialects.write(truth, habits, Path(folder), rng)
        end, why = outcome(truth, sample)
    return {"kind": truth.kind, "habits": habits, "tells": sample.tells, "outcome": end,
            "why": why.replace(folder, "")}
