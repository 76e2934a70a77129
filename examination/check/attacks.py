"""Does identification ever give a wrong number without a warning?

Benches and instruments of examination/attack_lab, which share no code with the package's physics,
have one fault each. Every identified number must be right within three standard errors or carry a
warning; otherwise it is silently wrong. Sound ones must cause no warning.

    ./bench check attacks [--only WORD] [--seeds 5] [--clean 50] [--processes 2] [--json FILE]
"""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from examination.attack_lab.cases import ATTACKS, Case, clean_bag, clean_tables
from examination.pieces import IN_PIECES, in_pieces, options_of, print_table
from sma_bench.errors import InputError
from sma_bench.identify import identify

LIMIT, FALSE_ALARMS = 3.0, 0.02
KINDS = ("right", "warned", "silent")
CLEAN = (clean_bag, clean_tables)


def judge(case: Case) -> dict[str, Any]:
    """Error of each number in standard errors, and its warnings; or the reason of a refusal."""
    try:
        found = identify(case.records, case.parameters, case.experiments)
    except InputError as error:
        return {"refused": str(error), "numbers": {}, "warnings": []}
    numbers = {}
    for name, truth in case.truth.items():
        if e := found.estimates.get(name):
            z = float((e.value - truth) / e.std)
            numbers[name] = {"truth": truth, "value": float(e.value), "std": float(e.std),
                             "z": z, "warnings": list(e.warnings)}  # fmt: skip
    return {"refused": "", "numbers": numbers, "warnings": list(found.warnings)}


def verdict(number: dict[str, Any]) -> str:
    if abs(number["z"]) < LIMIT:
        return "right"
    return "warned" if number["warnings"] else "silent"


def run(what: str, number: int, seed: int) -> dict[str, Any]:
    """An attack or a clean set, by number."""
    if what == "attack":
        return judge(ATTACKS[number].make(np.random.default_rng(7000 + seed), seed))
    return judge(CLEAN[number](np.random.default_rng(9000 + seed), seed))


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; 0 if nothing is silently wrong and clean records raise no alarm."""
    own = {"only": ("", "attacks with this in the name"), "seeds": (5, "of each attack")}
    own["clean"] = (50, "clean sets of each kind")
    options = options_of("attacks", __doc__, argv, **own, **IN_PIECES)
    chosen = [(k, a) for k, a in enumerate(ATTACKS)
              if options.only.lower() in f"{a.experiment} {a.name}".lower()]
    jobs = [("attack", k, seed) for k, _ in chosen for seed in range(options.seeds)]
    clean = [("clean", kind, seed) for kind in range(len(CLEAN)) for seed in range(options.clean)]
    found = in_pieces(run, jobs + clean, options)
    silent, false, rows = 0, 0, []
    for n, (_, attack) in enumerate(chosen):
        results = found[n * options.seeds : (n + 1) * options.seeds]
        every = [(name, n["z"], verdict(n)) for r in results for name, n in r["numbers"].items()]
        count = Counter(said for *_, said in every)
        shown = [x for x in every if x[2] == ("silent" if count["silent"] else "right")]
        name, z, _ = max(shown, key=lambda x: abs(x[1]), default=("", 0.0, ""))
        worst = f"{name.rpartition('.')[2]} z {z:+.1f}" if name else ""
        refused = sum(bool(r["refused"]) for r in results)
        rows.append((f"{attack.experiment:8}  {attack.name}", *(count[k] for k in KINDS), refused,
                     worst))
        silent += count["silent"]
    head = ("attack", *(f">{kind}" for kind in KINDS), ">refused")
    print_table((*head, "largest silent, or |z| when right"), rows)
    for job, result in zip(clean, found[len(jobs) :], strict=True):
        wrong = {n: x["z"] for n, x in result["numbers"].items() if verdict(x) == "silent"}
        alarms = [*result["warnings"], *filter(None, [result["refused"]])]
        silent += len(wrong)
        false += bool(alarms)
        if alarms or wrong:
            print("clean set", *job[1:], *alarms, wrong, sep="\n    ")
    print(f"\nsilently wrong: {silent}; false warnings on {false} of {len(clean)} clean sets")
    passed = silent == 0 and false <= FALSE_ALARMS * len(clean)
    print("PASSED" if passed else "FAILED")
    return 0 if passed else 1
