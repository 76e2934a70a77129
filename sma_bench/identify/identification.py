"""From records to parameters: which experiments the records allow, and the joining of results."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import noise_floor
from sma_bench.estimation.nuisances import UNITS
from sma_bench.estimation.observation import Observation, observe, observe_all, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.rig import find_pulls, is_clamped
from sma_bench.estimation.solver import fit
from sma_bench.estimation.unknowns import Unknowns
from sma_bench.findings import Finding
from sma_bench.identify import constitutive, signals, staircases, whole_model
from sma_bench.identify.fits import SYMBOLS, combine
from sma_bench.identify.isobaric import identify_isobaric, isobaric_tests
from sma_bench.identify.result import Experiment, Identification, Law, SignalFit, remark
from sma_bench.identify.run import SIGNIFICANT, IdentificationRun, about_wire
from sma_bench.identify.specific_heat import Drives, HeatLoss, identify_specific_heat
from sma_bench.identify.tensile import identify_tensile, tensile_tests
from sma_bench.identify.transition_temperatures import identify_transition_temperatures
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import load_kind
from sma_bench.progress import Report, part, silent
from sma_bench.records import DscRecord, Record
from sma_bench.records import record as record_module
from sma_bench.records.check import check_record
from sma_bench.records.instruments import IsobaricRecord, Phase, TensileRecord
from sma_bench.records.mend import comparable, mended
from sma_bench.records.open import AnyRecord, account_line
from sma_bench.records.record import has_samples, samples

NEEDS = {
    "E0": "E0 any voltage that changes, with current or temperature",
    "E1": f"E1 a staircase of {signals.FEWEST_LEVELS} voltages or more with current",
    "E2": f"E2 a staircase of {signals.FEWEST_LEVELS} voltages or more with temperature",
    "E3": "E3 a voltage ramp below A_s with temperature",
    "E5": "E5 a DSC file",
    "E6": "E6 isobaric test files (temperature, strain, stress), or a load frame that holds loads",
    "E7": "E7 tensile test files (strain, stress)",
    "E8": "E8 a clamped wire with temperature plateaus below A_s and force",
    "E9": "E9 voltage of one wire with its elongation under held loads, or isobaric test files",
    "E10": "E10 voltages of all channels with the deflection, ranges or elongation of a load",
}
EXPERIMENTS = tuple(NEEDS)
_WHOLE_MODEL = 0.9  # of the progress
_LEAST_DRIVE = 0.05  # V, least range of a voltage that can identify anything
_SMALL = 0.01  # of a mean: repeats that differ by less are not reported
# Signals that an experiment on bags reads; E1 to E3 predict the second.
_READS = {"E1": ("voltage", "current"), "E2": ("voltage", "temperature"),
          "E3": ("voltage", "temperature"), "E8": ("temperature", "force")}
_R, _H, _C_P = signals.RESISTANCE, signals.COEFFICIENT, signals.SPECIFIC_HEAT
_COMPUTED_WITH = {_R: (_H, _C_P), _H: (_C_P,)}  # results that depend on each


def identify(records: Sequence[AnyRecord], parameters: Parameters,
             experiments: Iterable[str] | None = None, report: Report = silent,
             phases: Mapping[str, Phase] | None = None) -> Identification:
    """Run the experiments that the records allow (`NEEDS`): E0 where no staircase gives E1 or E2;
    E10 includes bags of the load frame. R from one bag is used for the ramps of another.

    `experiments`: of EXPERIMENTS; None: all that the records allow, except E9 on clamped wires and
    isobaric files, which takes a minute; `phases`: of tensile tests, by pattern of file names.
    Raises InputError: an experiment is unknown or cannot be done, or nothing to identify at all."""
    wanted = frozenset(EXPERIMENTS if experiments is None else experiments)
    if unknown := sorted(wanted - set(EXPERIMENTS)):
        raise InputError(f"experiment {unknown[0]!r}, expected one of {', '.join(EXPERIMENTS)}")
    if not records:
        raise InputError("no record to identify from")
    bags = [r for r in records if isinstance(r, Record)]
    record_module.require_distinct(bags)
    repaired = [mended(record_module.as_driven(r, parameters), parameters) for r in bags]
    bags = [record_module.as_calibrated(record, parameters) for record, _ in repaired]
    known = signals.sensors_of(bags, parameters)
    run = IdentificationRun(known, wanted, asked=experiments is not None)
    run.notes.extend(f for _, found in repaired for f in found)
    imposed = ["elongation"] if load_kind(known) == "displacement" else []  # an input
    for k, record in enumerate(bags):
        run.notes.extend(record.findings)
        checked = [f for f in check_record(record) if f.subject not in imposed]
        run.notes.extend(f for f in checked if f.severity != "info" and f not in record.findings)
        bags[k], left_out = comparable(record, checked)
        run.notes.extend(left_out)
    run.notes.extend(about_wire(known))
    # Wires that move a load are identified by the whole model alone: E1 to E3 know no moving load.
    whole = _whole_model(run, bags, report)
    report(_WHOLE_MODEL if whole else 0.0, "experiments")
    still = [r for r in bags if not (whole and signals.moves(r, parameters))]
    drives, read = list[tuple[Record, signals.Drive]](), list[Record]()
    for record in still:
        try:
            drives += [(record, drive) for drive in signals.find_drives(record)]
            read.append(record)
        except InputError as error:
            for name in ("E1", "E2", "E3"):
                run.fail(name, str(error))
    _thermal(run, drives)
    # E0 if neither E1 nor E2 succeeded, or only E2 did and c_p is neither found nor given.
    driven, kinds = None, ("current", "temperature")
    slow = not (run.of("E1") or run.of("E3") or _C_P in parameters.given)
    if not run.of("E9") and (slow or not (run.of("E1") or run.of("E2"))):
        excited = [r for r in read if max(signals.driven(r, known).values(), default=0.0)
                   > _LEAST_DRIVE
                   and any(has_samples(r, f"{c}.{kind}") for c in r.channels for kind in kinds)]
        share, fit_wires = part(report, 0.0, _WHOLE_MODEL, "E0"), whole_model.identify_driven_wires
        if excited:
            driven = run.attempt("E0", lambda: fit_wires(excited, run.given, share))
    _material(run, records, bags, still, phases or {}, report)
    run.take_sharper(driven)
    run.take_sharper(whole)
    run.weigh_priors(driven, whole)
    run.keep_order(whole)
    _report_missing(run, records, drives)
    improved = run.improved()
    # Each estimate with its stated value and the warnings that concern it.
    remarks: list[tuple[Finding, Experiment | None]] = [(note, None) for note in run.notes]
    remarks += [(f, e) for e in run.experiments for f in e.findings]
    warned: dict[str, set[str]] = {}  # parameter names by warning
    for finding, own in ((f, own) for f, own in remarks if f.severity != "info"):
        line = f"{own.name + ' ' if own else ''}{finding.subject}: {finding.text}"
        warned.setdefault(line, set()).update(_concerned(finding, own, run.experiments))
    estimates = {}
    for name, e in run.estimates.items():
        stated = Estimate(float(known[name]), known.std(name), e.unit)
        about = tuple(line for line, names in warned.items() if name in names)
        stated_here = stated if name in known.given else None
        estimates[name] = replace(e, warnings=about, stated=stated_here)
    fits: dict[str, SignalFit] = {}  # by quantity, the worst of all records
    for quantity, one in _fits(run, bags, drives, improved):
        fits[quantity] = max(fits.get(quantity, one), one, key=lambda own: own.badness)
    laws = next((e.laws for e in run.experiments if e.laws), ())
    others = {law.law: law.probability for law in laws[1:]}
    return Identification(improved, estimates, tuple(run.experiments), tuple(run.notes), fits,
                          run.correlation(), tuple(warned),
                          accounts=tuple(filter(None, map(account_line, records))),
                          law=Law(laws[0].law, laws[0].probability, others) if laws else None)


def _concerned(finding: Finding, own: Experiment | None,
               experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """Names of the parameters that a remark concerns: the one it names and those computed with it;
    those read from the signal that it names; else all of its experiment, or of all experiments."""
    if finding.subject in BY_NAME:
        return (finding.subject, *_COMPUTED_WITH.get(finding.subject, ()))
    named = tuple(SYMBOLS[s] for s in finding.subject.split(", ") if s in SYMBOLS)
    if named or (own is None and finding.subject in NEEDS):
        return named
    if own is not None:
        return tuple(own.estimates)
    kinds = {s.rpartition("." if "." in s else "/")[2] for s in finding.subject.split(", ")}
    reading = [e for e in experiments if kinds & {*_READS.get(e.name, kinds)}]
    direct = [(n, *_COMPUTED_WITH.get(n, ())) for e in reading for n in e.estimates]
    return tuple(dict.fromkeys(name for names in direct for name in names))


def _whole_model(run: IdentificationRun, bags: Sequence[Record],
                 report: Report) -> Experiment | None:
    """Run E10 if a record shows the bench moving, else E9 if one shows a load frame."""
    moved = load_kind(run.given) == "displacement"  # then the frame's motion is an input
    bent, framed = [], []
    for r in bags:
        if signals.moves(r, run.given):
            bent.append(r)
        elif signals.holds_frame(r, run.given) and (moved or not find_pulls(r)):
            framed.append(r)
    name = "E10" if bent else "E9"
    loaded = not all(is_clamped(record) for record in framed)
    if not (bent or framed) or name not in run.wanted:
        return None
    if not (bent or loaded or run.asked):  # E8 gives Theta_T in a second
        return None
    if bent or loaded:
        # Above A_s the model of a clamped wire predicts a force that no real wire bears: leave out.
        limit = run.given[SYMBOLS["A_s"]]
        framed = [r for r in framed if not is_clamped(r)
                  or (has_samples(r, hot := f"{r.channels[0]}.temperature")
                      and np.percentile(samples(r, hot)[1], 99.0) < limit)]
    reporter, used = part(report, 0.0, _WHOLE_MODEL, name), [*framed, *bent]
    experiment = whole_model.identify_moving_bench if bent else whole_model.identify_load_frame
    return run.attempt(name, lambda: experiment(used, run.given, reporter))


def _thermal(run: IdentificationRun, drives: Drives) -> None:
    """E1 and E2 on every staircase, then E3 on all ramps together, with their R and h."""

    def serving(name: str, quantity: str, ramps: bool = False) -> Drives:
        """Staircases (or drives with ramps) with this signal; notes why other drives fail."""
        found = []
        for record, drive in drives if name in run.wanted else ():
            if not (drive.segments.ramps if ramps else drive.is_staircase):
                run.fail(name, f"{record.path}: {drive.describe()}", meant=False)
            elif not has_samples(record, f"{drive.channel}.{quantity}"):
                run.fail(name, f"{record.path}: no signal {drive.channel}.{quantity}")
            else:
                found.append((record, drive))
        return found

    def compare(name: str, found: Sequence[Estimate]) -> None:
        """Warn if staircases differ by more than their errors explain, before they are pooled."""
        mean, count = combine(found).value, len(found)
        far = max(found, key=lambda e: abs(e.value - mean) / e.statistical)
        limit = max(SIGNIFICANT * far.statistical / mean, _SMALL)
        if count > 1 and abs(far.value - mean) / mean >= limit:
            low, high = (100.0 * (end(e.value for e in found) / mean - 1) for end in (min, max))
            run.notes.append(remark("repeats differ", subject=name, count=count, low=low,
                                    high=high))

    def warm() -> Estimate:
        """Effective R: V^2/P with the voltage before the leads and the heat of a wire."""
        return staircases.heated(run.known(_R), run.given, _R in run.estimates)

    for record, drive in serving("E1", "current"):
        each = partial(staircases.identify_resistance, record, drive, run.given)
        run.attempt("E1", each)
    if done := run.of("E1"):
        compare(_R, [e.estimates[_R] for e in done])
        run.join("E1")
    # E2: combine gains, which are independent; coefficients would all contain the same resistance.
    for record, drive in serving("E2", "temperature"):
        each = partial(staircases.identify_heat_transfer, record, drive, run.given)
        run.attempt("E2", partial(each, warm()))
    gains = [e.details[staircases.GAIN] for e in run.of("E2")]
    if gains:
        compare(_H, gains)
        run.estimates[_H] = staircases.coefficient(combine(gains), warm(), run.given)
        rooms = [e.estimates[signals.AMBIENT] for e in run.of("E2")]
        run.estimates[signals.AMBIENT] = combine(rooms)
    # E3: c_p is proportional to the heat loss, so what E2 warns of concerns it, too.
    ramps = serving("E3", "temperature", ramps=True)
    if not ramps:
        return
    measured, gain = bool(gains) or _H in run.given.given, combine(gains) if gains else None
    default = Estimate(run.given[_H], run.given.std(_H), "", "default")
    heat_loss = HeatLoss(warm(), run.known(_H) if measured else default, gain, measured)
    fitted = run.attempt("E3", lambda: identify_specific_heat(ramps, run.improved(), heat_loss))
    if fitted:
        warned = [remark("heat loss uncertain", text=f.text) for e in run.of("E2")
                  for f in e.findings if f.severity == "warning" and f.subject == _H]
        run.experiments[-1] = replace(fitted, findings=(*fitted.findings, *warned))
    run.join("E3")


def _material(run: IdentificationRun, records: Sequence[AnyRecord], bags: Sequence[Record],
              still: Sequence[Record], phases: Mapping[str, Phase], report: Report) -> None:
    """E5, E6, E7 and E9 on instrument files and bags of load frames; E8 on clamped wires."""

    def try_on(name: str, found: Sequence[AnyRecord], experiment: Callable[[], Experiment]) -> None:
        if found:
            run.attempt(name, experiment)
            run.join(name)

    dsc = [r for r in records if isinstance(r, DscRecord)]
    tensile = [r for r in records if isinstance(r, TensileRecord)]
    isobaric = [r for r in records if isinstance(r, IsobaricRecord)]
    for record in still:
        if load_kind(run.given) != "displacement" and find_pulls(record):  # else E9's input
            tensile += tensile_tests(record, run.improved())
        # Load-frame loops under held loads go to E6 only if asked for: E9 gets more from them.
        alone = run.asked and "E6" in run.wanted and "E9" not in run.wanted
        if alone and signals.holds_frame(record, run.given) and not is_clamped(record):
            try:
                isobaric += isobaric_tests(record, run.improved())
            except InputError as error:
                run.fail("E6", str(error))
    try_on("E5", dsc, lambda: identify_transition_temperatures(dsc))
    # E7 takes the phase of its tests from E6's temperatures; E6's elastic strain needs E7's moduli.
    own = run.improved()
    if tensile and isobaric:
        with suppress(InputError):
            first = identify_isobaric(isobaric, own).estimates
            own = own.replace({name: e.value for name, e in first.items()})
    try_on("E7", tensile, lambda: identify_tensile(tensile, own, phases=phases))
    try_on("E6", isobaric, lambda: identify_isobaric(isobaric, run.improved()))
    if run.asked:
        joint, fit_all = part(report, 0.0, 1.0, "E9"), constitutive.fit_constitutive
        try_on("E9", isobaric, lambda: fit_all(isobaric, run.improved(), joint))
    held = load_kind(run.given) not in ("force", "spring", "antagonist")  # force is thermal stress
    clamped = [record for record in bags if held and signals.is_clamped_wire(record)]
    if not clamped or run.of("E9"):  # E9 gives Theta_T better
        return
    if run.another_alloy() and SYMBOLS["A_s"] not in run.estimates.keys() | run.given.given:
        run.fail("E8", "A_s is not stated, and the alloy is not the paper's")
        return
    try_on("E8", clamped, lambda: staircases.identify_thermal_expansion(clamped, run.improved()))


def _report_missing(run: IdentificationRun, records: Sequence[AnyRecord], drives: Drives) -> None:
    """Note each experiment without a result. InputError: none has one, or one was asked for."""
    missing = [name for name in EXPERIMENTS if name in run.wanted and not run.of(name)]
    reasons = {name: list(dict.fromkeys(run.reasons.get(name, []))) for name in missing}
    if not run.experiments or (run.asked and missing):
        every = [reason for name in missing for reason in reasons[name]]
        # List what was found once, instead of in the reason of every experiment.
        found = [f"{record.path}: {drive.describe()}" for record, drive in drives]
        bags = [r for r in records if isinstance(r, Record)]
        if not drives and not every:
            held = sorted({s for r in bags for s in r.signals})
            found = [f"signals {', '.join(held) or 'none'}"]
        for r in bags:
            if r.channels and not any(has_samples(r, f"{c}.voltage") for c in r.channels):
                found.append(f"{r.path}: no voltage of {', '.join(r.channels)}")
        what = "nothing to identify" if not run.experiments else f"no {', '.join(missing)}"
        listed = [name for name in missing if bags or reasons[name]] or missing
        raise InputError(f"{', '.join(str(r.path) for r in records)}: {what}: found "
                         f"{'; '.join(dict.fromkeys(found + every))}; needed: "
                         f"{'; '.join(NEEDS[name] for name in listed)}")
    for name in missing:
        if reasons[name]:  # E8 is tried on the force of any clamped wire
            meant = name in run.failed and name != "E8"
            run.notes.append(remark("not identified", "warning" if meant else "info", name,
                                    reasons="; ".join(reasons[name]), needs=NEEDS[name]))


def _fits(run: IdentificationRun, bags: Sequence[Record], drives: Drives,
          found: Parameters) -> Iterator[tuple[str, SignalFit]]:
    """How the model with these parameters fits the records that they were identified from, by
    quantity, after nuisances of each record (zeros, delays, moments of jumps) are fitted."""
    lag = run.estimates.get(signals.CAMERA_LAG)
    model = found.replace({signals.LAG: lag.value}) if lag else found
    whole = "; ".join(e.source for e in run.experiments if e.name in ("E0", "E9", "E10"))
    records = [record for record in bags if str(record.path) in whole.split("; ")]
    sets: list[list[Observation]] = [observe_all(records, model)] if records else []
    quantities = {_READS[e.name][1] for e in run.experiments if e.name in ("E1", "E2", "E3")}
    for record, drive in drives:
        head, rig = f"{drive.channel}.", signals.one_wire(model, drive.channel)
        own = {name: s for name, s in record.signals.items() if name.startswith(head)}
        alone = replace(record, signals=own)
        with suppress(InputError):  # a channel without a reading of any of these
            sets.append([observe(alone, rig, shared_bin([alone], rig), quantities)])
    known, still = Unknowns(model, (), 0, 0), np.zeros(0)
    for observations in sets:
        first = fit(Problem.of(observations).with_nuisances(model), known, still, rounds=1)
        # Again with the noise of these residuals: with guessed noise, zeros would follow a misfit.
        fitted = fit(first.problem, known, still, rounds=1, keep_noise=True)
        for block in fitted.problem.blocks:
            signal, residual = block.signal, fitted.residual[block.rows]
            # A bin's mean removes most of its samples' white noise: add it back.
            hidden = signal.scatter**2 * (1.0 - 1.0 / signal.usual_count)
            rms = float(np.sqrt(np.average(residual**2, weights=signal.count) + hidden))
            reach, unit = float(np.ptp(signal.value)), UNITS[signal.quantity]
            yield signal.quantity, SignalFit.judged(rms, signal.scatter, reach, unit)
    # Strain of isobaric loops against the model of E6 or E9, which may be more than the paper's.
    loops = [e for e in run.experiments if e.name in ("E6", "E9")]
    curves = loops[-1].curves if loops else {}
    for name, strain in curves.items():
        stem, _, kind = name.rpartition("/")
        if kind == "strain" and len(strain) >= 3:
            rms = float(np.sqrt(np.mean((strain - curves[f"{stem}/model"]) ** 2)))
            yield "strain", SignalFit.judged(rms, noise_floor(strain), float(np.ptp(strain)), "1")
