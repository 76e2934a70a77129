"""Are the results still the same numbers? Compares them with those stored in golden_numbers/.

Each stored number has a tolerance and a reason for it: after changes of the engine, only last
digits may differ. Only the public interface is used: `import sma_bench` and the command line.

    ./bench check golden [identify simulate diagnose paper] [--only NAME] [--write]
    ./bench check golden blind60      # measures of 60 development cases, six minutes on one core

Exits with 1 if a number is outside its tolerance or missing. Results that need measured data beside
the checkout are skipped, by name, if the data are not there.
"""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import yaml

import sma_bench

# --- The results: numbers with tolerances. These functions stay, whatever changes behind the public
# interface.
ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(__file__).with_name("golden_numbers")
CONFIG = ROOT / "config"
DATA = ROOT.parent / "shared" / "data"
sys.path.insert(0, str(ROOT / "examples"))
_MADE = yaml.safe_load((KEPT / "made.yaml").read_text(encoding="utf-8"))
REASONS: dict[str, str] = _MADE["reasons"]
SECTIONS = tuple(_MADE["tasks"])
DAILY = SECTIONS[:4]
DEVELOPMENT_SEED, BLIND = 1000, "examination.blind.command"


# --- numbers -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Number:
    """A number with a tolerance, or a text or count that must be the same. `side`: "" if both
    directions count as outside, "+" if only larger, "-" if only smaller values do."""

    value: float | int | str | None
    tolerance: float
    reason: str
    side: str = ""

    def moved(self, now: "Number") -> float:
        """Deviation of `now` in units of this number's tolerance; infinite if not comparable."""
        if self.value == now.value:
            return 0.0
        if not (self.tolerance and is_number(self.value) and is_number(now.value)):
            return math.inf
        moved = (now.value - self.value) / self.tolerance
        return moved if math.isfinite(moved) else math.inf

    def is_outside(self, now: "Number") -> bool:
        """True if `now` is outside the tolerance."""
        moved = self.moved(now)
        return {"": abs(moved), "+": moved, "-": -moved}[self.side] > 1.0

    def __str__(self) -> str:
        return f"{self.value:.7g}" if is_number(self.value) else str(self.value)


Numbers = dict[str, Number]


@dataclass(frozen=True)
class Result:
    """One record identified, one case diagnosed, ...: its numbers, or why there are none.
    `seconds`: CPU time; `skipped`: data that are missing; `failed`: the error."""

    numbers: Numbers
    seconds: float = 0.0
    skipped: str = ""
    failed: str = ""


def exact(value: float | str | None) -> Number:
    """A verdict, a name or a count, which must be the same."""
    return Number(value, 0.0, "exact")


def within(value: float | None, tolerance: float, reason: str, side: str = "") -> Number:
    """A number with its tolerance, both rounded as stored."""
    if not is_number(value) or not math.isfinite(float(value or 0.0)):
        return exact(None if value is None else str(value))
    return Number(float(f"{float(value or 0.0):.9g}"), float(f"{tolerance:.3g}"), reason, side)


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


def is_number(value: Any) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool)


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
    numbers["experiments"] = exact(" ".join(sorted(one["name"] for one in result["experiments"])))
    for table, estimates in tables.items():
        for name, value in estimates.items():
            numbers |= estimate(f"{table}{name}", value)
    return numbers | (unseen_errors(sma_bench.load(unseen), found.parameters) if unseen else {})


def unseen_errors(record: Any, parameters: Any) -> Numbers:
    """Rms of simulated minus measured, as a share of the range of each signal."""
    run = sma_bench.load(sma_bench.simulate(record, parameters))
    wanted, numbers = ("current", "temperature", "deflection", "elongation"), {}
    for name in sorted(record.signals.keys() & run.signals.keys()):
        told, made = record[name], run[name]
        if name.rpartition(".")[2] not in wanted or not np.ptp(told.values):  # constant signal
            continue
        gap = np.interp(told.time, made.time, made.values) - told.values
        if name in ("deflection", "elongation"):
            gap -= np.median(gap)  # its zero is arbitrary
        error = 100.0 * float(np.sqrt(np.mean(gap**2)) / np.ptp(told.values))
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


def development_case(folder: str, number: int) -> Numbers:
    case = sorted(path.parent for path in Path(folder).glob("**/nominal.yaml"))[number]
    return diagnosed(case / "record", case / "nominal.yaml", case / "hold_out")


def diagnosed(record: Any, parameters: Any, hold_out: Any) -> Numbers:
    """Verdict, cause, place and probabilities, and how far the gap shrinks."""
    result = sma_bench.diagnose(record, parameters, hold_out).to_json()
    candidates = sorted(result["candidates"], key=lambda found: -found["probability"])
    numbers = {
        "verdict": exact(result["verdict"]),
        "cause": exact(" + ".join(sorted(result["cause"]))),
        "first choice": exact(candidates[0]["name"]),
        **{f"where, {key}": exact(result["where"][key]) for key in ("signal", "phase", "side")}}
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
    numbers = {"errata": exact(len(page["errata"])), "figures": exact(len(page["figures"]))}
    for table, rows in page["tables"].items():
        for row in rows:
            name = f"{table}, {row['description']} ({row['quantity']})"
            numbers[f"{name}, printed"] = exact(row["paper"])
            found = row["identified"] or {"value": None, "std": None}
            numbers |= estimate(f"{name}, identified", found)
    return numbers


def blind_measures(cases: str, jobs: str) -> Numbers:
    """The scorer's measures on development cases, without follow-up experiments."""
    with tempfile.TemporaryDirectory(prefix="sma_bench_golden_") as made:
        answers, score = f"{made}/diagnosis", f"{made}/score.json"
        asked = ("--answers", answers, "--jobs", jobs, "--time-limit", PATIENCE)
        before = _processor_time()
        sma_bench_command("run", cases, *asked, module=BLIND)
        each = (_processor_time() - before) / SCORED_CASES
        scored = ("--answers", answers, "--no-follow-up", "--json", score)
        sma_bench_command("score", cases, *scored, module=BLIND)
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


def make_cases(folder: str, number: int, jobs: int) -> None:
    what = ("--seed", str(DEVELOPMENT_SEED), "--n", str(number), "--out", folder)
    sma_bench_command("make", *what, "--jobs", str(jobs), module=BLIND)


def sma_bench_command(*arguments: str, module: str = "sma_bench.cli") -> None:
    """Run a command quietly. RuntimeError: it failed, with the last line of its output."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["nothing said"]
        raise RuntimeError(f"{module} {' '.join(arguments)}: {said[-1]}")


# --- the results --------------------------------------------------------------------------------
SHOWN = 0.01  # tolerances: smaller changes of a number are not listed
Results = Mapping[str, Result]


def tasks(section: str, cases: str = "", jobs: int = 1) -> dict[str, dict[str, Any]]:
    """Recipes of the results of a section, as in made.yaml. `cases`: folder of sets by size;
    `jobs`: processes for blind60."""

    def filled(value: Any) -> Any:
        if isinstance(value, list):
            return [filled(one) for one in value]
        return value.format(data=DATA, cases=cases, jobs=jobs) if isinstance(value, str) else value

    return {name: row | {"arguments": filled(row.get("arguments", []))}
            for name, row in _MADE["tasks"][section].items()}


def made(row: Mapping[str, Any]) -> Result:
    needed, begin = DATA / row.get("needs", ""), _processor_time()
    if "needs" in row and not needed.is_dir():
        return Result({}, skipped=f"no measured data in {needed}")
    try:
        numbers = globals()[row["function"]](*row["arguments"], **row.get("named", {}))
    except Exception as error:  # one failure must not stop the others
        line = f"{type(error).__name__}: {error}".replace(f"{DATA}/", "")
        return Result({}, _processor_time() - begin, failed=line)
    return Result(numbers, _processor_time() - begin)


def _processor_time() -> float:
    """CPU time in s of this process and of its ended children."""
    return sum(os.times()[:4])


def compare(kept: Results, now: Results) -> Iterator[tuple[bool, str]]:
    """Numbers that changed, are missing or new: whether outside the tolerance, and a line."""
    for result, found in now.items():
        old = kept[result].numbers if result in kept else {}
        for name in dict.fromkeys([*old, *found.numbers]) if not found.skipped else ():
            where, before, after = f"{result}: {name}", old.get(name), found.numbers.get(name)
            if before is None:
                yield False, f"new      {where}: {after}"
            elif after is None:
                yield True, f"OUTSIDE  {where}: gone, was {before}"
            elif abs(far := before.moved(after)) > SHOWN:
                outside = before.is_outside(after)
                by = f"{before} is now {after}, {far:+.2f} tolerances ({before.reason})"
                yield outside, f"{'OUTSIDE' if outside else 'moved':8} {where}: {by}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="./bench check golden", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    add = parser.add_argument
    add("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}")
    add("--only", default="", metavar="NAME", help="results with this in the name")
    add("--write", action="store_true", help="keep the numbers as they are now")
    add("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    options = parser.parse_args(argv)
    sections = list(dict.fromkeys(options.sections or DAILY))
    if unknown := [section for section in sections if section not in SECTIONS]:
        parser.error(f"no section {unknown[0]!r}, expected some of {', '.join(SECTIONS)}")

    now: dict[str, dict[str, Result]] = {section: {} for section in sections}
    with tempfile.TemporaryDirectory(prefix="sma_bench_golden_") as cases:
        due = [(section, name, row) for section in sections
               for name, row in tasks(section, cases, options.jobs).items() if options.only in name]
        if not due:
            _say(f"no result has {options.only!r} in its name")
            return 2
        for number in sorted({row["cases"] for *_, row in due if "cases" in row}):
            _say(f"making {number} development cases")
            make_cases(f"{cases}/{number}", number, options.jobs)
        calls = (joblib.delayed(made)(row) for *_, row in due)
        results = joblib.Parallel(options.jobs, return_as="generator")(calls)
        for count, ((section, name, _), result) in enumerate(zip(due, results, strict=True), 1):
            now[section][name] = result
            _say(f"{count}/{len(due)}  ({section}: {name})")
    failures = sum(report(section, found, options) for section, found in now.items())
    print("FAILED" if failures else "PASSED")
    return 1 if failures and not options.write else 0


def report(section: str, found: dict[str, Result], options: argparse.Namespace) -> int:
    """Print the changes in a section, store the numbers with --write; how many are outside."""
    file = KEPT / f"{section}.json"
    before = read(file)
    if not options.only:
        gone = Result({}, failed="nothing makes this result any more")
        found |= {name: gone for name in before if name not in found}
    moves = sorted(compare(before, found), key=lambda move: not move[0])
    outside, old = sum(out for out, _ in moves), [before[n] for n in found if n in before]
    print(f"\n{section}: {len(found)} results, {sum(len(r.numbers) for r in old)} numbers kept, "
          f"{len(moves)} moved, gone or new, {outside} outside; "
          f"{sum(r.seconds for r in found.values()):.0f} s of processor time, "
          f"{sum(r.seconds for r in old):.0f} s then")  # fmt: skip
    for name, result in found.items():
        if result.skipped or result.failed:
            word = "skipped" if result.skipped else "FAILED"
            print(f"  {word:8} {name}: {result.skipped or result.failed}")
    print(*(f"  {line}\n" for _, line in moves), sep="", end="")
    if options.write:
        written = before | {name: result for name, result in found.items() if result.numbers}
        order = [*(name for name in found if name in written), *written]
        write(file, {name: written[name] for name in order})
    return outside


def _say(text: str) -> None:
    print(f"golden: {text}", file=sys.stderr, flush=True)


def read(path: Path) -> dict[str, Result]:
    results = {}
    for name, result in json.loads(path.read_text())["results"].items() if path.is_file() else ():
        numbers = {key: Number(*entry) if isinstance(entry, list) else exact(entry)
                   for key, entry in result["numbers"].items()}  # fmt: skip
        results[name] = Result(numbers, result["seconds"])
    return results


def write(path: Path, results: Results) -> None:
    """One number per line: the value if exact, else value, tolerance, reason, side."""
    used = {n.reason for result in results.values() for n in result.numbers.values()}
    reasons = {reason: text for reason, text in REASONS.items() if reason in used}
    blocks = []
    for name, result in results.items():
        lines = []
        for key, n in result.numbers.items():
            entry = [n.value, n.tolerance, n.reason, *([n.side] if n.side else [])]
            text = json.dumps(n.value if n.reason == "exact" else entry)
            lines.append(f"    {json.dumps(key)}: {text}")
        head, text = f'{{"seconds": {result.seconds:.1f}, "numbers": {{', ",\n".join(lines)
        blocks.append(f"  {json.dumps(name)}: {head}\n{text}\n  }}}}")
    text, tolerances = ",\n".join(blocks), json.dumps(reasons, indent=1)
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'{{"tolerances": {tolerances},\n"results": {{\n{text}\n}}}}\n')
