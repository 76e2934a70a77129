"""Bags damaged at random places: never a crash, the loss stated; of an mcap all before the damage
is read, a damaged sqlite3 file is refused."""

import contextlib
import io
import random
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from examination.campaign.allowance import allowance
from examination.campaign.hostile_inputs import FOR_ALL, Case, run_command
from examination.campaign.numbered_bag import (
    FORMATS,
    MESSAGES,
    NumberedBag,
    numbered_bag,
    numbers_in,
)
from examination.campaign.outcome import Outcome
from sma_bench.cli import main
from sma_bench.diagnose import diagnose
from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters
from sma_bench.records import Record, describe, read_record

_BLOCKS = (1, 8, 64, 512, 4096, 20_000)
_SHOWN_FAILURES = 3
# What reading one of these small bags may take at most.
MEMORY = 1 << 30
SECONDS = 20.0
# A drive takes this many as long as a bag of numbers, and its diagnosis its time.
_NUMBERED_A_DRIVE = 90
_DIAGNOSIS_SECONDS = 180.0
_RIG = Path(__file__).resolve().parents[2] / "config" / "wire_rig.yaml"

Damage = Callable[[random.Random, bytes, int, int], bytes]


DAMAGES: dict[str, Damage] = {
    "a bit flipped": lambda rng, raw, at, n: (
        raw[:at] + bytes([raw[at] ^ 1 << rng.randrange(8)]) + raw[at + 1 :]
    ),
    "cut off": lambda rng, raw, at, n: raw[:at],
    "zeroed": lambda rng, raw, at, n: raw[:at] + bytes(min(n, len(raw) - at)) + raw[at + n :],
    "overwritten": lambda rng, raw, at, n: (
        raw[:at] + rng.randbytes(min(n, len(raw) - at)) + raw[at + n :]
    ),
    "a block twice": lambda rng, raw, at, n: raw[: at + n] + raw[at:],
    "a block gone": lambda rng, raw, at, n: raw[:at] + raw[at + n :],
}


@dataclass(frozen=True)
class Verdict:
    """What reading one damaged bag came to.

    Attributes:
        failure: an exception that should not be, messages before the damage that were not read,
            or a loss that nothing stated; "" where none.
        refused: the bag as a whole, in one line.
        lost: messages, of MESSAGES.
        altered: messages read with another number than was written, and nothing said so.
    """

    failure: str = ""
    refused: bool = False
    lost: int = 0
    altered: int = 0


def damaged_bags(size: int, seed: int, folder: Path) -> list[Outcome]:
    """Damage `size` bags, spread over formats and kinds of damage."""
    bags = [numbered_bag(folder / name.replace(" ", "_"), name) for name in FORMATS]
    repeat = max(1, round(size / len(bags) / len(DAMAGES)))
    outcomes = []
    for bag in bags:
        verdicts = []
        for name, damage in DAMAGES.items():
            rng = random.Random(f"{seed} {bag.format} {name}")
            verdicts += [
                _try_once(bag, damage, rng, folder / "copy") for _ in range(repeat)
            ]
        outcomes.append(_outcome(bag, verdicts))
    return [*outcomes, _damaged_drives(max(1, size // _NUMBERED_A_DRIVE), seed, folder)]


def _damaged_drives(size: int, seed: int, folder: Path) -> Outcome:
    """A drive that can be identified and diagnosed, damaged, through every command."""
    drive, copy, out = (folder / name for name in ("drive", "drive copy", "out"))
    with contextlib.redirect_stdout(io.StringIO()):
        main([
            "simulate", "--protocol", "quick_staircase", "--params", str(_RIG), "--rate", "20",
            "--noise", "1", "--out", str(drive),
        ])  # fmt: skip
    storage = next(file.name for file in drive.iterdir() if file.name != "metadata.yaml")
    raw = (drive / storage).read_bytes()
    failures, results = [], 0
    for k in range(size):
        rng = random.Random(f"{seed} drive {k}")
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(drive, copy)
        damage = rng.choice(list(DAMAGES.values()))
        at = rng.randrange(1, len(raw))
        (copy / storage).write_bytes(damage(rng, raw, at, rng.choice(_BLOCKS)))
        out.mkdir(exist_ok=True)
        for command in FOR_ALL:
            options = () if command == "info" else ("--params", str(_RIG))
            text, code = run_command(command, Case(copy, options), out, _DIAGNOSIS_SECONDS)
            failures += [f"drive {k}: {command}: {text}"] if text else []
            results += code == 0
    found = f"failed {len(failures)}, {results} results of {size * len(FOR_ALL)}"
    return Outcome(
        "bags", f"damaged drives through {', '.join(FOR_ALL)}", size,
        "; ".join([found, *failures[:_SHOWN_FAILURES]]), "failed 0", not failures,
    )


def _try_once(bag: NumberedBag, damage: Damage, rng: random.Random, copy: Path) -> Verdict:
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(bag.path, copy)
    storage = copy / bag.storage
    raw = storage.read_bytes()
    at = rng.randrange(1, len(raw))
    damaged = damage(rng, raw, at, rng.choice(_BLOCKS))
    storage.write_bytes(damaged)
    differs = next((k for k, (a, b) in enumerate(zip(raw, damaged, strict=False)) if a != b), None)
    whole = bag.numbers_before(min(len(raw), len(damaged)) if differs is None else differs)
    return judge(bag, copy, whole if damaged != raw else set(range(MESSAGES)))


def judge(bag: NumberedBag, copy: Path, whole: set[int]) -> Verdict:
    """Read the copy, of which the messages numbered `whole` lie before the damage."""
    try:
        with allowance(MEMORY, SECONDS):
            record = read_record(copy)
            describe(record)
            _use(record)
    except InputError as error:
        if "\n" in str(error):
            return Verdict(f"more than one line: {error!s:.80}")
        missed = ""
        if whole and not bag.format.startswith("sqlite3"):
            missed = f"{len(whole)} messages before the damage not read: {error}"
        return Verdict(missed, refused=True, lost=MESSAGES)
    except Exception as error:  # that is what is looked for
        return Verdict(f"{type(error).__name__}: {error!s:.80}")
    found = numbers_in(record)
    right = {number for number, value in found.items() if value == number}
    # A number that became NaN is one that was not measured, of which there is an info.
    stated = any(f.severity != "info" or "nan" in f.numbers for f in record.findings)
    if missed := whole - right:
        return Verdict(f"{len(missed)} messages before the damage not read, {min(missed)} first")
    # What was read with another stamp is altered too.
    read = len(record.signals.get("wire.voltage", ()))
    lost, altered = MESSAGES - read, read - len(right)
    if lost > 0 and not stated:
        return Verdict(f"{lost} messages lost, nothing said so", lost=lost)
    return Verdict(lost=lost + altered, altered=0 if stated else altered)


def _use(record: Record) -> None:
    """What commands do with a record that they can read; that it is refused is no failure."""
    for use in (identify, diagnose):
        try:
            use([record], Parameters.defaults())
        except InputError as error:
            if "\n" in str(error):
                raise AssertionError(f"more than one line: {error!s:.80}") from None


def _outcome(bag: NumberedBag, verdicts: list[Verdict]) -> Outcome:
    failures = Counter(verdict.failure for verdict in verdicts if verdict.failure)
    lost = np.array([verdict.lost for verdict in verdicts if not verdict.refused])
    altered = [verdict.altered for verdict in verdicts if verdict.altered]
    found = (
        f"failed {sum(failures.values())}, refused in one line "
        f"{sum(verdict.refused for verdict in verdicts)}; of {MESSAGES} messages lost "
        f"{np.median(lost) if len(lost) else MESSAGES:.0f} in the median"
    )
    if altered:
        found += f"; {len(altered)} bags with a number altered unseen"
    for failure, count in failures.most_common(_SHOWN_FAILURES):
        found += f"; {count} x {failure}"
    limit = "failed 0" if bag.without_checksum else "failed 0, none altered unseen"
    met = not failures and (bag.without_checksum or not altered)
    return Outcome("bags", f"damaged {bag.format}", len(verdicts), found, limit, met)
