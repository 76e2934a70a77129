"""From records to parameters: finds out what each record holds and runs the experiments."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify import load_frame, whole_model
from sma_bench.identify.constitutive.joint_fit import fit_constitutive
from sma_bench.identify.fit_verdict import fits_of_curves, fits_of_observations, worst
from sma_bench.identify.instruments.isobaric import identify_isobaric
from sma_bench.identify.instruments.tensile import identify_tensile
from sma_bench.identify.instruments.thermal_expansion import identify_thermal_expansion
from sma_bench.identify.instruments.transition_temperatures import (
    identify_heating_rates,
    identify_transition_temperatures,
)
from sma_bench.identify.result import Correlation, Experiment, Identification, SignalFit
from sma_bench.identify.run import (
    COEFFICIENT,
    RESISTANCE,
    IdentificationRun,
    about_wire,
    find_all_drives,
    run_heat_transfer,
    run_resistance,
    run_specific_heat,
)
from sma_bench.identify.signals import FEWEST_LEVELS, ChannelDrive, as_calibrated, sensors_of
from sma_bench.identify.thermal.specific_heat import CAMERA_LAG, LAG, observe_channel
from sma_bench.identify.thermal.specific_heat import PARAMETER as SPECIFIC_HEAT
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME, TRANSITIONS
from sma_bench.progress import Report, by_name, part, silent
from sma_bench.records import DscRecord, Record
from sma_bench.records.check import account_line, check_record
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.record import has_samples, samples
from sma_bench.records.tensile import Phase, TensileRecord
from sma_bench.records.trust import mended

NEEDS = {
    "E0": "E0 any voltage that changes, with current or temperature",
    "E1": f"E1 a staircase of {FEWEST_LEVELS} voltages or more with current",
    "E2": f"E2 a staircase of {FEWEST_LEVELS} voltages or more with temperature",
    "E3": "E3 a voltage ramp below A_s with temperature",
    "E5": "E5 a DSC file",
    "E6": "E6 isobaric test files (temperature, strain, stress), or a load frame that holds loads",
    "E7": "E7 tensile test files (strain, stress)",
    "E8": "E8 a clamped wire with temperature plateaus below A_s and force",
    "E9": "E9 voltage of one wire with its elongation under held loads, or isobaric test files",
    "E10": "E10 voltages of all channels with the deflection, ranges or elongation of a load",
}
EXPERIMENTS = tuple(NEEDS)
_FAR_APART = 4.0
_LEAST_DRIVE = 0.05  # V
_THERMAL = {"E1": run_resistance, "E2": run_heat_transfer, "E3": run_specific_heat}
# Parts of the time: a whole-model fit takes most of it, and so does E9 where it is asked for.
_WHOLE_MODEL = 0.9
_PLAN = {"E1": 1.0, "E2": 1.0, "E3": 1.0, "E5": 1.0, "E6": 1.0, "E7": 1.0, "E8": 1.0}
_JOINT = 0.3
# Every clamped wire's force is tried for E8, whatever its voltages were meant for.
_TRIED_ON_CHANCE = frozenset({"E8"})


# What an experiment on bags reads, and what its numbers go with.
_READS = {
    "E1": ("voltage", "current"), "E2": ("voltage", "temperature"),
    "E3": ("voltage", "temperature"), "E8": ("temperature", "force"),
}
_GO_WITH = {RESISTANCE: (COEFFICIENT, SPECIFIC_HEAT), COEFFICIENT: (SPECIFIC_HEAT,)}
_SYMBOLS = {
    **TRANSITIONS, "C_A": "wire.stress_influence_austenite",
    "C_M": "wire.stress_influence_martensite", "E_M": "wire.martensite_modulus",
    "E_A": "wire.austenite_modulus", "eps_L": "wire.maximum_recoverable_strain",
    "Theta_T": "wire.thermal_expansion_factor",
}


def concerned(
    finding: Finding, own: Experiment | None, experiments: Sequence[Experiment]
) -> tuple[str, ...]:
    """Names of the parameters that a remark is about: the one it names, with what goes with it;
    those read from the signal that it names; else all of its experiment, or of all."""
    if finding.subject in BY_NAME:
        return (finding.subject, *_GO_WITH.get(finding.subject, ()))
    named = tuple(_SYMBOLS[s] for s in finding.subject.split(", ") if s in _SYMBOLS)
    if named or (own is None and finding.subject in NEEDS):
        return named
    if own is not None:
        return tuple(own.estimates)
    kind = finding.subject.rpartition("." if "." in finding.subject else "/")[2]
    direct = [
        name for e in experiments if kind in _READS.get(e.name, (kind,)) for name in e.estimates
    ]
    return tuple(dict.fromkeys(n for name in direct for n in (name, *_GO_WITH.get(name, ()))))


def _line(finding: Finding, own: Experiment | None) -> str:
    return f"{own.name + ' ' if own else ''}{finding.subject}: {finding.text}"


def identify(
    records: Sequence[AnyRecord], parameters: Parameters, experiments: Iterable[str] | None = None,
    report: Report = silent, phases: Mapping[str, Phase] | None = None,
) -> Identification:
    """Identify what the records allow.

    Staircases give E1 and E2, without any another drive that excites gives E0; ramps E3, DSC files
    E5, isobaric test files E6, tensile ones E7, the force of a clamped wire E8, load frames that
    hold loads E9, the composite and wires against a load E10 (which takes the load frame's bags
    along: the same alloy). Several records are combined: the resistance of one bag serves the ramps
    of another.

    Args:
        records: bags and instrument files, already read.
        parameters: what is known beforehand (mass, area, A_s, ...).
        experiments: names out of EXPERIMENTS; all that the records hold when None, but E9 on
            clamped wires and isobaric files, which takes a minute, only when named.
        report: called with how far it is.
        phases: of tensile tests, by file name or pattern of names.

    Raises:
        InputError: unknown experiment, one that was asked for but cannot be done, or nothing at
            all to identify; the line lists what was found and what is missing.
    """
    wanted = frozenset(EXPERIMENTS if experiments is None else experiments)
    unknown = sorted(wanted - set(EXPERIMENTS))
    if unknown:
        raise InputError(f"experiment {unknown[0]!r}, expected one of {', '.join(EXPERIMENTS)}")
    if not records:
        raise InputError("no record to identify from")
    sound = [mended(r) for r in records if isinstance(r, Record)]
    bags = [as_calibrated(record, parameters) for record, _ in sound]
    known = sensors_of(bags, parameters)
    run = IdentificationRun(known, wanted, asked=experiments is not None)
    run.notes.extend(f for _, found in sound for f in found)
    run.notes.extend(f for record in bags for f in _remarks(record))
    run.notes.extend(about_wire(known))
    whole = _whole_model(run, bags, report)
    reporter = by_name(part(report, _WHOLE_MODEL if whole else 0.0, 1.0), _PLAN)
    # Wires that move a load are identified by the whole model alone: their staircases bend it.
    still = [r for r in bags if not (whole and whole_model.moves(r, parameters))]
    drives = find_all_drives(run, still)
    for name, thermal in _THERMAL.items():
        reporter(name)
        thermal(run, drives)
    driven = _driven(run, still, drives, report)
    pulled = [test for r in still for test in load_frame.tensile_tests(r, run.improved())]
    _instruments(run, [*records, *pulled, *_held(run, still)], phases or {}, reporter, report)
    reporter("E8")
    _thermal_expansion(run, bags)
    _take_sharper(run, driven)
    _take_sharper(run, whole)
    run.weigh_priors(driven, whole)
    run.keep_order(whole)
    _report_missing(run, records, drives)
    improved = run.improved()
    # The estimates with what was stated of them and what is to be said of each.
    remarks: list[tuple[Finding, Experiment | None]] = [(note, None) for note in run.notes]
    remarks += [(f, e) for e in run.experiments for f in e.findings]
    warned = [(f, own) for f, own in remarks if f.severity != "info"]
    doubts: dict[str, dict[str, None]] = {name: {} for name in run.estimates}
    for finding, own in warned:
        for name in concerned(finding, own, run.experiments):
            doubts.get(name, {})[_line(finding, own)] = None
    given = run.given
    estimates = {
        name: replace(
            e, warnings=tuple(doubts[name]),
            stated=Estimate(float(given[name]), given.std(name), e.unit)
            if name in given.given else None,
        )
        for name, e in run.estimates.items()
    }

    # Correlation of all errors; between experiments as far as the same sensors are behind them.
    names, every = list(run.estimates), list(run.estimates.values())
    sources = sorted({source for e in every for source in e.shares})
    matrix = np.eye(len(names))
    for own in (e for e in run.experiments if e.correlation is not None):
        assert own.correlation is not None
        chosen = [
            (k, names.index(name)) for k, name in enumerate(own.correlation.names)
            if name in names and own.estimates.get(name) == run.estimates[name]
        ]
        if chosen:
            here, there = np.array(chosen).T
            matrix[np.ix_(there, there)] = own.correlation.matrix[np.ix_(here, here)]
    std = np.array([max(e.std, 1e-300) for e in every])
    own_parts = np.array([e.statistical for e in every]) / std
    shares = [[e.shares.get(s, 0.0) for s in sources] for e in every]
    common = np.array(shares).reshape(len(every), len(sources)) / std[:, np.newaxis]
    matrix = matrix * np.outer(own_parts, own_parts) + common @ common.T
    np.fill_diagonal(matrix, 1.0)
    return Identification(
        improved, estimates, tuple(run.experiments), tuple(run.notes),
        _fit(run, bags, drives, improved), Correlation(tuple(names), matrix),
        tuple(dict.fromkeys(_line(f, own) for f, own in warned)),
        accounts=tuple(filter(None, map(account_line, records))),
    )


# What an experiment on bags holds against its model.
_PREDICTS = {"E1": "current", "E2": "temperature", "E3": "temperature"}


def _fit(
    run: IdentificationRun, bags: Sequence[Record],
    drives: Sequence[tuple[Record, ChannelDrive]], found: Parameters,
) -> dict[str, SignalFit]:
    """How the model with these parameters fits what they were identified from."""
    lag = run.estimates.get(CAMERA_LAG)
    model = found.replace({LAG: lag.value}) if lag else found
    fits: list[tuple[str, SignalFit]] = []
    done = {e.name for e in run.experiments}
    if whole := done & {whole_model.NAME, whole_model.DRIVEN, load_frame.NAME}:
        used = {path for e in run.experiments if e.name in whole for path in e.source.split("; ")}
        records = [record for record in bags if str(record.path) in used]
        if records:
            fits += fits_of_observations(whole_model.observe_all(records, model), model)
    quantities = {_PREDICTS[name] for name in done if name in _PREDICTS}
    for record, drive in drives:
        with suppress(InputError):  # a channel without a reading of any of these
            one = observe_channel(record, drive.channel, model, quantities)
            fits += fits_of_observations([one], model)
    loops = [e for e in run.experiments if e.name in ("E6", load_frame.NAME)]
    for experiment in loops[-1:]:
        fits += fits_of_curves(experiment.curves)
    return worst(fits)


def _remarks(record: Record) -> Iterator[Finding]:
    yield from record.findings
    own = [f for f in check_record(record) if f.severity != "info"]
    yield from (f for f in own if f not in record.findings)


def _whole_model(
    run: IdentificationRun, bags: Sequence[Record], report: Report
) -> Experiment | None:
    """E10 where a record shows the bench moving, else E9 where one shows a load frame."""
    bent = [record for record in bags if whole_model.moves(record, run.given)]
    framed = [
        r for r in bags
        if load_frame.holds_frame(r) and r not in bent and not load_frame.find_pulls(r)
    ]
    name = whole_model.NAME if bent else load_frame.NAME
    if not (bent or framed) or name not in run.wanted:
        return None
    loaded = any(load_frame.holds_loads(record) for record in framed)
    if bent or loaded:
        framed = [
            r for r in framed if load_frame.holds_loads(r) or load_frame.stays_cold(r, run.given)
        ]
    if not (bent or run.asked or loaded):
        text = "the force of a clamped wire is there: --experiment E9 fits the whole model to it"
        run.notes.append(Finding("info", name, text))
        return None
    reporter = part(report, 0.0, _WHOLE_MODEL, name)
    try:
        if bent:
            experiment = whole_model.identify_moving_bench([*framed, *bent], run.given, reporter)
        else:
            experiment = load_frame.identify_load_frame(framed, run.given, reporter)
    except InputError as error:
        run.fail(name, str(error))
        return None
    run.experiments.append(experiment)
    return experiment


def _driven(
    run: IdentificationRun, bags: Sequence[Record],
    drives: Sequence[tuple[Record, ChannelDrive]], report: Report,
) -> Experiment | None:
    """E0 on all records whose wires are driven and read, where no staircase was found in any."""
    name = whole_model.DRIVEN
    if name not in run.wanted or run.of("E1") or run.of("E2") or run.of(load_frame.NAME):
        return None
    excited = [
        record for record in bags
        if any(
            record is own and _changes(record, f"{drive.channel}.voltage") for own, drive in drives
        )
        and any(
            has_samples(record, f"{c}.{q}")
            for c in record.channels for q in ("current", "temperature")
        )
    ]
    if not excited:
        return None
    try:
        fitted = whole_model.identify_driven_wires(
            excited, run.given, part(report, 0.0, _WHOLE_MODEL, name)
        )
    except InputError as error:
        run.fail(name, str(error))
        return None
    run.experiments.append(fitted)
    return fitted


def _changes(record: Record, name: str) -> bool:
    """Whether a voltage is anything but one level."""
    return has_samples(record, name) and bool(np.ptp(samples(record, name)[1]) > _LEAST_DRIVE)


def _held(run: IdentificationRun, bags: Sequence[Record]) -> list[IsobaricRecord]:
    """Loops under the loads that a frame held, where E6 is asked for: E9 tells more by the same."""
    if not run.asked or "E6" not in run.wanted or load_frame.NAME in run.wanted:
        return []
    framed = (r for r in bags if load_frame.holds_frame(r) and load_frame.holds_loads(r))
    tests: list[IsobaricRecord] = []
    for record in framed:
        try:
            tests += load_frame.isobaric_tests(record, run.improved())
        except InputError as error:
            run.fail("E6", str(error))
    return tests


def _instruments(
    run: IdentificationRun, records: Sequence[AnyRecord], phases: Mapping[str, Phase],
    reporter: Callable[[str], None], report: Report,
) -> None:
    """E5, E6, E7 and E9 on instrument files, each on all files of its kind together."""
    dsc = [r for r in records if isinstance(r, DscRecord)]
    isobaric = [r for r in records if isinstance(r, IsobaricRecord)]
    tensile = [r for r in records if isinstance(r, TensileRecord)]
    reporter("E5")
    if len(dsc) == 1 and _rate_follows_cycle(dsc[0]):
        _try(run, "E5", lambda: identify_transition_temperatures(dsc[0]))
    elif dsc:
        _try(run, "E5", lambda: identify_heating_rates(dsc))
    reporter("E6")
    # Tensile tests take their phase from E6's temperatures, and give the moduli of E6's elastic
    # part: so the temperatures come first, then the moduli, then E6 as a whole.
    own = run.improved()
    if tensile and isobaric:
        with suppress(InputError):
            own = own.replace(
                {n: e.value for n, e in identify_isobaric(isobaric, own).estimates.items()}
            )
    reporter("E7")
    if tensile:
        _try(run, "E7", lambda: identify_tensile(tensile, own, phases=phases))
    if isobaric:
        _try(run, "E6", lambda: identify_isobaric(isobaric, run.improved()))
    if isobaric and run.asked:
        joint = part(report, _JOINT, 1.0, "E9")
        _try(run, "E9", lambda: fit_constitutive(isobaric, run.improved(), report=joint))


def _rate_follows_cycle(record: DscRecord) -> bool:
    """Whether one run's cycles differ in rate, which must not pass for a law of the rate."""
    scans = [s for s in record.segments if s.kind != "isothermal"]
    return len({round(abs(s.rate) * 60.0, 1) for s in scans}) > 1


def _thermal_expansion(run: IdentificationRun, bags: Sequence[Record]) -> None:
    """E8 on the clamped wires among the bags; the whole model tells it better where it ran."""
    clamped = [record for record in bags if load_frame.is_clamped_wire(record)]
    if clamped and not run.of(load_frame.NAME):
        channel = clamped[0].channels[0]
        start = "wire.austenite_start_temperature"
        if run.another_alloy() and start not in run.estimates.keys() | run.given.given:
            run.fail("E8", "A_s is not stated, and the alloy is another than the paper's")
            return
        _try(
            run, "E8", lambda: identify_thermal_expansion(
                clamped, run.improved(), temperature=f"{channel}.temperature"
            )
        )


def _try(run: IdentificationRun, name: str, experiment: Callable[[], Experiment]) -> None:
    if name not in run.wanted:
        return
    try:
        run.experiments.append(experiment())
    except InputError as error:
        run.fail(name, str(error))
    run.join(name)


def _take_sharper(run: IdentificationRun, whole: Experiment | None) -> None:
    """Of what an experiment of its own and the whole model both tell, the sharper number counts.

    They may rest on the same samples, so they are not averaged.
    """
    for name, estimate in (whole.estimates if whole else {}).items():
        other = run.estimates.get(name)
        if other is not None:
            apart = (estimate.value - other.value) / math.hypot(estimate.std, other.std)
            if abs(apart) > _FAR_APART:
                text = f"the whole model says {estimate.value:.6g} +- {estimate.std:.2g} " + (
                    f"{estimate.unit}, {apart:+.1f} standard errors from {other.value:.6g} +- "
                    f"{other.std:.2g} ({other.method})"
                )
                run.notes.append(Finding("warning", name, text, {"deviations": apart}))
        if other is None or estimate.std < other.std:
            run.estimates[name] = estimate


def _report_missing(
    run: IdentificationRun, records: Sequence[AnyRecord],
    drives: Sequence[tuple[Record, ChannelDrive]],
) -> None:
    """A note for each experiment without a result, a warning where a record was meant for it; an
    error if that leaves nothing."""
    missing = run.missing(EXPERIMENTS)
    if not run.experiments or (run.asked and missing):
        where = ", ".join(str(r.path) for r in records)
        reasons = list(dict.fromkeys(r for n in missing for r in run.reasons.get(n, [])))
        # What was found says more than a reason for each experiment that repeats it.
        found = [f"{record.path}: {drive.describe()}" for record, drive in drives]
        if not drives:
            held = sorted({s for r in records if isinstance(r, Record) for s in r.signals})
            found = [f"signals {', '.join(held) or 'none'}"] if not reasons else []
        shown = "; ".join(dict.fromkeys(found + reasons))
        needs = "; ".join(NEEDS[name] for name in missing)
        what = "nothing to identify" if not run.experiments else f"no {', '.join(missing)}"
        raise InputError(f"{where}: {what}: found {shown}; needed: {needs}")
    for name in missing:
        if name in _TRIED_ON_CHANCE:
            continue
        reasons = list(dict.fromkeys(run.reasons.get(name, [])))
        if reasons:
            text = f"not identified ({'; '.join(reasons)}); needed: {NEEDS[name]}"
            run.notes.append(Finding("warning" if name in run.failed else "info", name, text))
