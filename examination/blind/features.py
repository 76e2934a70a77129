"""Development cases searched once each: what the decision looks at, beside the label.

Cases cover all loads, one or two records and missing signals; a third of the owners state half of
their numbers only. Half of the benches without an effect are plain: their equations are the
baseline's, and of those where nothing is wrong half have the very numbers that are stated. Labels
say what can be told from the records that are searched, with the numbers that are stated. What is
found is kept under a hash of the library, one line a case.
"""

import hashlib
import json
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from examination.blind import cases
from examination.blind.case_files import RECALIBRATION
from examination.blind.cases import QUANTITIES
from examination.blind.make import Sized, make_label, size
from examination.blind.rigs import RECORDS
from sma_bench.diagnose.facts import weighed
from sma_bench.diagnose.search import search
from sma_bench.diagnose.utilities import Utilities
from sma_bench.errors import InputError
from sma_bench.estimation.observation import observe_all
from sma_bench.parameters import Parameters
from sma_bench.records import Record
from sma_bench.records.mend import mended

PACKAGE = Path(__file__).resolve().parents[2] / "sma_bench"
# Those that the package's weights are learnt from, packed.
STORED = Path(__file__).with_name("features.jsonl.gz")
# What the numbers of a search depend on; the decision is fitted to them.
_LIBRARY = ("parameters", "physics", "records", "estimation", "diagnose")
_NOT_ITS = ("decision.py", "diagnosis.py", "next_experiment.py", "result.py", "utilities.py")
_LOADS = ("beam", "clamped", "force", "beam", "spring", "beam", "antagonist")  # in turn
_UNSTATED, _LESS_SIGNALS = 1 / 3, 0.35  # of the owners; of the benches that read all
_PLAIN, _AS_STATED = 0.5, 0.5  # of the benches without an effect; of plain ones with nothing wrong
_STATED_ALWAYS = ("bench.", "load.", "composite.", "wire.diameter", "wire.length", "wire.count")
_STREAM = 2_000_003  # apart from those that cases are made of


def library_hash() -> str:
    """Of all that a search depends on."""
    paths = sorted(p for room in _LIBRARY for p in (PACKAGE / room).rglob("*.py"))
    paths.append(PACKAGE / "parameters" / "effects.yaml")
    whole = b"".join(path.read_bytes() for path in paths if path.name not in _NOT_ITS)
    return hashlib.sha256(whole).hexdigest()[:16]


def keep_features(out: Path, seed: int, n: int) -> None:
    """Add the cases to `out` that it does not hold yet, one by one: each a line of JSON. Raises
    InputError where the file is of another library, or of other cases."""
    library = library_hash()
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    for line in lines:
        if (line["library"], line["seed"], line["n"]) != (library, seed, n):
            raise InputError(f"{out}: holds features of another library, or of other cases")
    done = {line["index"] for line in lines}
    for index in (k for k in range(n) if k not in done):
        begun = time.monotonic()
        found = {"library": library, "seed": seed, "n": n, "index": index}
        found |= features_of(seed, n, index)
        with out.open("a") as file:
            file.write(json.dumps(found, separators=(",", ":")) + "\n")
        said = "+".join(found["label"]["effects"]) or found["label"]["kind"]
        print(f"{index + 1}/{n} {time.monotonic() - begun:.0f} s: {said}", flush=True)


def features_of(seed: int, n: int, index: int) -> dict[str, Any]:
    """Label, facts and today's probabilities of one case."""
    load = _LOADS[index % len(_LOADS)]
    deck = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(cases.DECK,)))
    card = cases.deal(n, deck, load)[index]
    own = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, index)))
    if card.signals == cases.ALL and own.random() < _LESS_SIGNALS:
        known = {**cases.EFFECTS, **cases.OUTSIDE}
        shown = load != cases.CLAMPED and all(known[n].in_deflection for n in card.effects)
        less = "without current", "without temperature"
        card = replace(card, signals=less[int(own.integers(2)) if shown else 0])
    plain = card.kind in (cases.NONE, RECALIBRATION) and bool(own.random() < _PLAIN)
    if plain:
        card = replace(card, noise="white")
    case = cases.draw_case(seed, index, card, f"{index:04d}", load)
    sized = Sized({}, {}, {}, {}, 0.0, 0.0) if plain else size(case)
    names = RECORDS[: int(own.integers(1, 3))]
    nominal = case.nominal
    if plain and card.kind == cases.NONE and own.random() < _AS_STATED:
        nominal = nominal.replace({n: case.truth[n] for n in nominal.given_uncertainty})
    if own.random() < _UNSTATED:  # of the wire's half is from the table, as far off as wires differ
        numbers = sorted(n for n in nominal.given if not n.startswith(_STATED_ALWAYS))
        dropped = set(own.permutation(numbers)[: len(numbers) // 2].tolist())
        stds = {n: s for n, s in nominal.given_uncertainty.items() if n not in dropped}
        nominal = Parameters({n: nominal[n] for n in nominal.given if n not in dropped}, stds)
    label = make_label(case, sized, names, nominal)
    records = []
    for name in names:
        signals = {s.name: s for s in case.signals(sized.features, name)}
        records.append(mended(Record(Path(name), case.starts[name], signals))[0])
    looked_at = weighed(search(observe_all(records, nominal, QUANTITIES[card.signals]), nominal))
    utilities = Utilities(looked_at)
    today = dict(zip(utilities.names, utilities.probabilities().round(6).tolist(), strict=True))
    wanted = ("kind", "effects", "signals", "noise", "kinetics", "severity", "severities", "wrong",
              "distinguishable", "load", "forms", "law_distance", "transformation_law",
              "loops_distance", "inner_loops", "beyond_parameters")  # fmt: skip
    return {"label": {name: label[name] for name in wanted}, "today": today, "plain": plain,
            "records": len(names), "stated": len(nominal.given), "facts": asdict(looked_at)}

