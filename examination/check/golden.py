"""Are the results still the same numbers? Compares them with those stored in golden_numbers/.

Each stored number has a tolerance and a reason for it: after changes of the engine, only last
digits may differ. Only the public interface is used: `import sma_bench` and the command line.

    ./bench check golden [identify simulate diagnose paper] [--only NAME] [--write]
    ./bench check golden blind60      # measures of 60 development cases, six minutes on one core

Exits with 1 if a number is outside its tolerance or missing. Results that need measured data beside
the checkout are skipped, by name, if the data are not there.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

import sma_bench
from examination.pieces import AT_ONCE, in_pieces, options_of
from sma_bench.parameters.yaml_file import write_text_atomically

# --- The results: numbers with tolerances. These functions stay, whatever changes behind the public
# interface.
ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(__file__).with_name("golden_numbers")
CONFIG = ROOT / "config"
DATA = ROOT.parent / "shared" / "data"
sys.path.insert(0, str(ROOT / "examples"))
_MADE = yaml.safe_load((KEPT / "made.yaml").read_text().replace("{data}", str(DATA)))
REASONS: dict[str, str] = _MADE["reasons"]
TASKS: dict[str, dict[str, dict[str, Any]]] = _MADE["tasks"]
SECTIONS = tuple(TASKS)
DAILY = SECTIONS[:4]
DEVELOPMENT_SEED, BLIND = 1000, "examination.blind.command"


# --- numbers -----------------------------------------------------------------------------------
class Number(NamedTuple):
    """A number with a tolerance, or a text or count that must be the same. `side`: "" if both
    directions count as outside, "+" if only larger, "-" if only smaller values do."""

    value: float | int | str | None
    tolerance: float = 0.0
    reason: str = "exact"
    side: str = ""

    def moved(self, now: "Number") -> float:
        """Deviation of `now` in units of this number's tolerance; infinite if not comparable."""
        if self.value == now.value:
            return 0.0
        if not (self.tolerance and is_number(self.value) and is_number(now.value)):
            return math.inf
        moved = (now.value - self.value) / self.tolerance
        return moved if math.isfinite(moved) else math.inf

    def __str__(self) -> str:
        return f"{self.value:.7g}" if is_number(self.value) else str(self.value)


Numbers = dict[str, Number]


def is_number(value: Any) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)


def within(value: float | None, tolerance: float, reason: str, side: str = "") -> Number:
    """A number with its tolerance, both rounded as stored."""
    if value is None or not math.isfinite(value):
        return Number(None if value is None else str(value))
    return Number(float(f"{value:.9g}"), float(f"{tolerance:.3g}"), reason, side)


def relative(value: float | None, share: float, reason: str) -> Number:
    """A number with a share of itself as its tolerance."""
    return within(value, share * abs(value or 0.0), reason)


def estimate(name: str, found: Mapping[str, Any]) -> Numbers:
    """A value and its stated standard error."""
    value, std = found["value"], found["std"]
    own = relative(value, 1e-3, "no error stated")
    if std and math.isfinite(std):
        own = within(value, 0.1 * std, "standard error")
    return {name: own, f"{name}, std": relative(std, 0.1, "curvature")}


# --- what is computed: identify -----------------------------------------------------------------
WIRE, DEMO, COMPOSITE = (CONFIG / f"{rig}_rig.yaml" for rig in ("wire", "demo", "composite"))


def simulated_wire(*protocols: str, changed: Mapping[str, float] | None = None) -> Numbers:
    """A simulated wire rig recorded through instruments, identified from the table's defaults."""
    truth = sma_bench.load_parameters(WIRE).replace(dict(changed or {}))
    return identified([_recorded(name, truth, 50.0, k) for k, name in enumerate(protocols, 1)])


def thermal_validation() -> Numbers:
    """E4: identified from a staircase and a ramp, validated on a triangle."""
    truth = sma_bench.load_parameters(WIRE)
    seen = [_recorded(name, truth, 50.0, 1) for name in ("quick_staircase", "quick_ramp")]
    found = sma_bench.identify(seen, WIRE)
    return unseen_errors(_recorded("triangle", truth, 50.0, 2), found.parameters)


def clamped_wire() -> Numbers:
    """E8: the force of a clamped wire, after a staircase has been identified."""
    truth = sma_bench.load_parameters(WIRE)
    before = sma_bench.identify(_recorded("quick_staircase", truth, 50.0, 1), WIRE).parameters
    return identified([_recorded("thermal_expansion", truth, 20.0, 1)], before)


def simulated_composite() -> Numbers:
    truth = sma_bench.load_parameters(COMPOSITE)
    records = [_recorded(n, truth, 50.0, 1) for n in ("composite_step", "composite_triangle")]
    return identified(records, COMPOSITE)


def instrument_files(experiment: str, *names: str) -> Numbers:
    """E5, E6, E7, E9: synthetic files in the instruments' export formats."""
    from make import instrument_text
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            Path(folder, name).write_text(instrument_text(name))
        return identified([Path(folder, name) for name in names], None, [experiment])


def measured(pattern: str, experiment: str = "") -> Numbers:
    records = sorted(str(path) for path in DATA.glob(f"sma_react/input/{pattern}"))
    return identified(records, None, [experiment] if experiment else None)


def foreign_spring() -> Numbers:
    """A wire against a spring, foreign data: identified from two runs, validated on a third."""
    bench, rig = DATA / "foreign" / "spring", str(DATA / "foreign" / "spring" / "rig.yaml")
    with tempfile.TemporaryDirectory() as made:
        for name in ("run_a.csv", "run_b_european.txt", "run_c.mat"):
            out = f"{made}/{name[:5]}"
            sma_bench_command("import", str(bench / name), "--params", rig, "--out", out)
        return identified([f"{made}/run_a", f"{made}/run_b"], rig, None, f"{made}/run_c")


def identified(records: Sequence[Any], parameters: Any = None,
               experiments: Sequence[str] | None = None, unseen: Any = None) -> Numbers:
    """Experiments, estimates and details of `identify`; errors on a hold-out record."""
    found = sma_bench.identify(list(records), parameters, experiments)
    result, numbers = found.to_json(), {}
    tables = {"": result["parameters"]}
    tables |= {f"{one['name']}: ": one.get("details", {}) for one in result["experiments"]}
    numbers["experiments"] = Number(" ".join(sorted(one["name"] for one in result["experiments"])))
    for table, estimates in tables.items():
        for name, value in estimates.items():
            numbers |= estimate(f"{table}{name}", value)
    return numbers | (unseen_errors(sma_bench.load(unseen), found.parameters) if unseen else {})


def unseen_errors(record: Any, parameters: Any) -> Numbers:
    """Rms of simulated minus measured, as a share of the range of each signal."""
    run = sma_bench.load(sma_bench.simulate(record, parameters))
    wanted, numbers = ("current", "temperature", "deflection", "elongation"), {}
    for name in sorted(record.signals.keys() & run.signals.keys()):
        seen, made = record[name], run[name]
        if name.rpartition(".")[2] not in wanted or not np.ptp(seen.values):  # constant signal
            continue
        gap = np.interp(seen.time, made.time, made.values) - seen.values
        if name in ("deflection", "elongation"):
            gap -= np.median(gap)  # its zero is arbitrary
        error = 100.0 * float(np.sqrt(np.mean(gap**2)) / np.ptp(seen.values))
        key, tolerance = f"unseen run, {name}: error in % of its span", max(0.05 * error, 0.01)
        numbers[key] = within(error, tolerance, "unseen", "+")
    return numbers


def _recorded(protocol: str, truth: Any, rate: float, seed: int) -> Any:
    return sma_bench.measure(sma_bench.simulate(protocol, truth, rate=rate), seed)


# --- what is computed: simulate -----------------------------------------------------------------
SPAN = 1e-5
INSTANTS = (29, 62, 83)  # %


def simulated(rig: str, protocol: str, **effects: float) -> Numbers:
    """One wire per side and the deflection: minimum, maximum, mean, and values at some instants."""
    run = sma_bench.simulate(protocol, CONFIG / f"{rig}_rig.yaml", effects=effects, rate=50.0)
    record = sma_bench.load(run)
    wires = ["wire"] if rig == "wire" else ["front_1", "back_1"]
    names = [f"{wire}.{signal}" for wire in wires for signal in ("current", "temperature")]
    signals = {name: record[name].values
               for name in [*names, "deflection"] if name in record.signals}
    for wire, k in zip(wires, range(0, run.martensite_fraction.shape[1], 2), strict=True):
        signals[f"{wire}, martensite fraction"] = run.martensite_fraction[:, k]
    numbers = {}
    for name, values in signals.items():
        # Instants during heating and during cooling, for both sides.
        at = {f"at {k} %": values[k * len(values) // 100] for k in INSTANTS}
        shown = {"least": values.min(), "largest": values.max(), "mean": values.mean(), **at}
        tolerance = max(SPAN * float(np.ptp(values)), 1e-12)
        for what, value in shown.items():
            numbers[f"{name}, {what}"] = within(float(value), tolerance, "span")
    return numbers


# --- what is computed: diagnose -----------------------------------------------------------------
# Deviations of the demo's bench from the lab's parameters, in stated standard deviations.
LAB_ERRORS = (0.8, -1.1, 0.3, 1.4, -0.6, -0.2, 1.0, -1.3, 0.5)
SCORED_CASES = 60
PATIENCE = "600"  # s per case: no case may fail by a timeout on a loaded machine


def diagnosed_demo(hidden: Mapping[str, float]) -> Numbers:
    """Part 2 of the demo without nodes: a bench with errors as stated, and a hidden effect."""
    lab = sma_bench.load_parameters(DEMO)
    stated = lab.given_uncertainty
    errors = zip(np.resize(LAB_ERRORS, len(stated)), stated.items(), strict=True)
    truth = lab.replace({name: float(lab[name] + error * std) for error, (name, std) in errors})
    runs = (sma_bench.simulate(f"composite_diagnosis_{name}", truth, effects=hidden)
            for name in ("triangles", "steps"))
    seen, unseen = (sma_bench.measure(run, seed) for seed, run in enumerate(runs, 1))
    return diagnosed(seen, lab, unseen)


def development_case(cases: str, number: int) -> Numbers:
    case = sorted(path.parent for path in Path(cases).glob("**/nominal.yaml"))[number]
    return diagnosed(case / "record", case / "nominal.yaml", case / "hold_out")


def diagnosed(record: Any, parameters: Any, hold_out: Any) -> Numbers:
    """Verdict, cause, place and probabilities, and how far the gap shrinks."""
    result = sma_bench.diagnose(record, parameters, hold_out).to_json()
    candidates = sorted(result["candidates"], key=lambda found: -found["probability"])
    numbers = {
        "verdict": Number(result["verdict"]),
        "cause": Number(" + ".join(sorted(result["cause"]))),
        "first choice": Number(candidates[0]["name"]),
        **{f"where, {key}": Number(result["where"][key]) for key in ("signal", "phase", "side")}}
    for candidate in candidates:
        if candidate["probability"] >= 0.01:
            name = f"probability of {candidate['name']}"
            numbers[name] = within(candidate["probability"], 0.02, "evidence")
    numbers["gap over noise"] = relative(candidates[0]["gap_over_noise"], 0.02, "optimum")
    for name, found in result["shrinkage"].items():
        low, high = found["ci90"]
        width = 0.0 if None in (low, high) else high - low
        numbers[f"{name}, gap gone"] = within(found["fraction"], max(0.1 * width, 5e-3), "interval")
        numbers[f"{name}, RMSE after"] = relative(found["rmse_after"], 0.02, "optimum")
    return numbers


# --- what is computed: paper, blind60 -----------------------------------------------------------
def paper() -> Numbers:
    """Every row of the paper's tables, and the errata."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "paper.json"
        sma_bench_command("paper", "--out", f"{folder}/page", "--json", str(file))
        page = json.loads(file.read_text())
    numbers = {"errata": Number(len(page["errata"])), "figures": Number(len(page["figures"]))}
    for table, rows in page["tables"].items():
        for row in rows:
            name = f"{table}, {row['description']} ({row['quantity']})"
            numbers[f"{name}, printed"] = Number(row["paper"])
            found = row["identified"] or {"value": None, "std": None}
            numbers |= estimate(f"{name}, identified", found)
    return numbers


def blind_measures(cases: str) -> Numbers:
    """The scorer's measures on development cases, without follow-up experiments."""
    score, before = f"{cases}/score.json", _processor_time()
    sma_bench_command("run", cases, "--time-limit", PATIENCE, module=BLIND)
    each = (_processor_time() - before) / SCORED_CASES
    sma_bench_command("score", cases, "--no-follow-up", "--json", score, module=BLIND)
    found = json.loads(Path(score).read_text())["scores"]["diagnosis"]["measures"]
    numbers = {"processor time of a case, s": within(each, 0.5 * each, "time", "+")}
    for side, names in _MADE["measures"].items():
        for name in names:
            value, n = found[name]["value"], found[name]["n"]
            tolerance = (0.5 / max(n, 1), "case")
            if name in ("90 % set, mean size", "probability given to the truth"):
                tolerance = (0.02 * (value or 0.0), "not worse")
            numbers[name] = within(value, *tolerance, side)
    return numbers


def sma_bench_command(*arguments: str, module: str = "sma_bench.cli") -> None:
    """Run a command quietly. RuntimeError: it failed, with the last line of its output."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["nothing said"]
        raise RuntimeError(f"{module} {' '.join(arguments)}: {said[-1]}")


# --- the results --------------------------------------------------------------------------------
SHOWN = 0.01  # tolerances: smaller changes of a number are not listed
# A result as stored: its numbers, s of CPU time; or `problem`: why it has no numbers.
Result = dict[str, Any]


def made(section: str, name: str, cases: str) -> Result:
    """A result of made.yaml; `cases`: folder of sets of development cases by size."""
    row, begin = TASKS[section][name], _processor_time()
    needed = DATA / row.get("needs", "")
    if not needed.is_dir() and "needs" in row:
        return {"numbers": {}, "seconds": 0.0, "problem": f"skipped: no measured data in {needed}"}
    arguments = [f"{cases}/{row['cases']}"] if "cases" in row else []
    numbers, problem = {}, ""
    try:
        function = globals()[row["function"]]
        numbers = function(*arguments, *row.get("arguments", ()), **row.get("named", {}))
    except Exception as error:  # one failure must not stop the others
        problem = f"FAILED: {type(error).__name__}: {error}".replace(f"{DATA}/", "")
    return {"numbers": numbers, "seconds": _processor_time() - begin, "problem": problem}


def _processor_time() -> float:
    """CPU time in s of this process and of its ended children."""
    return sum(os.times()[:4])


def compare(result: str, kept: Numbers, now: Numbers) -> Iterator[tuple[bool, str]]:
    """Numbers that changed, are missing or new: whether outside the tolerance, and a line."""
    for name in dict.fromkeys([*kept, *now]):
        before, after = kept.get(name), now.get(name)
        if before is None:
            yield False, f"new      {result}: {name}: {after}"
        elif after is None:
            yield True, f"OUTSIDE  {result}: {name}: gone, was {before}"
        elif abs(far := before.moved(after)) > SHOWN:
            outside = {"": abs(far), "+": far, "-": -far}[before.side] > 1.0
            word = "OUTSIDE " if outside else "moved   "
            by = f"{before} is now {after}, {far:+.2f} tolerances ({before.reason})"
            yield outside, f"{word} {result}: {name}: {by}"


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of(
        "golden", __doc__, argv, sections=(list(SECTIONS), "without one: all but blind60"),
        only=("", "results with this in the name"), write=(False, "keep the numbers as they are"),
        **AT_ONCE)
    now: dict[str, dict[str, Result]] = {one: {} for one in options.sections or DAILY}
    with tempfile.TemporaryDirectory(prefix="sma_bench_golden_") as folder:
        due = [(section, name, folder) for section in now for name in TASKS[section]
               if options.only in name]
        for number in sorted({TASKS[section][name].get("cases", 0) for section, name, _ in due}):
            what = ("--seed", str(DEVELOPMENT_SEED), "--n", str(number))
            if number:
                sma_bench_command("make", *what, "--out", f"{folder}/{number}", module=BLIND)
        for (section, name, _), result in zip(due, in_pieces(made, due, options), strict=True):
            now[section][name] = result
    failures = sum(report(section, found, options) for section, found in now.items())
    print("FAILED" if failures else "PASSED")
    return 1 if failures and not options.write else 0


def report(section: str, found: dict[str, Result], options: Any) -> int:
    """Print the changes in a section, store the numbers with --write; how many are outside."""
    before = read(section)
    for name in before.keys() - found.keys() if not options.only else ():
        found[name] = {"numbers": {}, "seconds": 0.0, "problem": "FAILED: no longer made"}
    moves = [move for name, result in found.items() if not result["problem"].startswith("skipped")
             for move in compare(name, before[name]["numbers"] if name in before else {},
                                 result["numbers"])]
    outside, old = sum(out for out, _ in moves), [before[name] for name in found if name in before]
    now, then = (sum(result["seconds"] for result in of) for of in (found.values(), old))
    print(f"\n{section}: {len(found)} results, {sum(len(r['numbers']) for r in old)} numbers kept, "
          f"{len(moves)} moved, gone or new, {outside} outside; {now:.0f} s of processor time, "
          f"{then:.0f} s then")
    print(*(f"  {r['problem']}: {name}\n" for name, r in found.items() if r["problem"]),
          *(f"  {line}\n" for _, line in sorted(moves, key=lambda move: not move[0])),
          sep="", end="")
    if options.write:
        write(section, before | {name: one for name, one in found.items() if one["numbers"]})
    return outside


def read(section: str) -> dict[str, Result]:
    """The stored results of a section, by name."""
    path = KEPT / f"{section}.json"
    results = json.loads(path.read_text())["results"] if path.is_file() else {}
    for result in results.values():
        result["numbers"] = {key: Number(*(entry if isinstance(entry, list) else [entry]))
                             for key, entry in result["numbers"].items()}
    return results


def write(section: str, results: dict[str, Result]) -> None:
    """One number per line: the value if exact, else value, tolerance, reason, side."""
    blocks, used = [], {"exact"}
    for name, result in results.items():
        used |= {number.reason for number in result["numbers"].values()}
        lines = (f"    {json.dumps(key)}: "
                 + json.dumps(n.value if n.reason == "exact" else [*n[:3], *filter(None, n[3:])])
                 for key, n in result["numbers"].items())
        head = f'  {json.dumps(name)}: {{"seconds": {result["seconds"]:.1f}, "numbers": {{'
        blocks.append(f"{head}\n" + ",\n".join(lines) + "\n  }}")
    reasons = json.dumps({name: text for name, text in REASONS.items() if name in used}, indent=1)
    text = f'{{"tolerances": {reasons},\n"results": {{\n' + ",\n".join(blocks) + "\n}}\n"
    write_text_atomically(KEPT / f"{section}.json", text)
