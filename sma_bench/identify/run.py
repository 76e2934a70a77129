"""One identification under way: what the records gave so far, and why something is missing."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.unknowns import MATERIAL, PRODUCTS
from sma_bench.findings import Finding
from sma_bench.identify.estimate import combine, with_prior
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import (
    ChannelDrive,
    Staircase,
    find_drives,
    has_samples,
    missing_findings,
)
from sma_bench.identify.thermal.heat_transfer import (
    AMBIENT,
    GAIN,
    coefficient,
    identify_heat_transfer,
)
from sma_bench.identify.thermal.resistance import CHANNEL, heated, identify_resistance
from sma_bench.identify.thermal.specific_heat import PARAMETER as SPECIFIC_HEAT
from sma_bench.identify.thermal.specific_heat import HeatLoss, identify_specific_heat
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import NITI_DENSITY
from sma_bench.parameters.table import BY_NAME, TRANSITIONS
from sma_bench.records import Record


@dataclass
class IdentificationRun:
    """Results by experiment and by parameter, remarks, and reasons by experiment.

    `asked` is False where nobody named the experiments: then slow ones wait to be asked for.
    """

    given: Parameters
    wanted: frozenset[str]
    asked: bool = False
    experiments: list[Experiment] = field(default_factory=list)
    estimates: dict[str, Estimate] = field(default_factory=dict)
    notes: list[Finding] = field(default_factory=list)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)

    def of(self, name: str) -> list[Experiment]:
        """Experiments done under this name."""
        return [e for e in self.experiments if e.name == name]

    def fail(self, name: str, reason: str, meant: bool = True) -> None:
        """Note why a record gave nothing to an experiment; `meant`: which it was driven for."""
        self.reasons.setdefault(name, []).append(reason)
        self.failed |= {name} if meant else set()

    def known(self, name: str) -> Estimate:
        """An identified number, else the given one; a default nobody measured is remarked."""
        if name in self.estimates:
            return self.estimates[name]
        stated = name in self.given.given
        text = f"{self.given[name]:g} +- {self.given.std(name):g} taken from the " + (
            "given parameters" if stated else "table of defaults, nobody measured it on this wire"
        )
        finding = Finding("info" if stated else "warning", name, text)
        if finding not in self.notes:
            self.notes.append(finding)
        return Estimate(self.given[name], self.given.std(name), "", "given", 0)

    def join(self, name: str) -> None:
        """Put an experiment's estimates, joined over its records, among the results."""
        found = self.of(name)
        for parameter in dict.fromkeys(p for e in found for p in e.estimates):
            own = combine([e.estimates[parameter] for e in found if parameter in e.estimates])
            if parameter in self.estimates:
                # What an experiment gives that is nearer to what the model uses,
                # beside what another gave: a calorimeter's tangents, the cosines
                # of a loaded wire, the joint fit of all.
                other = self.estimates[parameter]
                apart = (own.value - other.value) / math.hypot(own.std, other.std)
                far = abs(apart) > _SIGNIFICANT
                text = (
                    f"{own.value:.6g} +- {own.std:.2g} {own.unit} of {name} is taken, {apart:+.1f} "
                    f"standard errors from {other.value:.6g} +- {other.std:.2g} ({other.method})"
                ) + (": one of the two is wrong, or the specimens differ" if far else "")
                numbers = {"deviations": apart}
                self.notes.append(Finding("warning" if far else "info", parameter, text, numbers))
            self.estimates[parameter] = own

    def improved(self) -> Parameters:
        """The given parameters with what is identified put in, as far as they may hold it."""
        found, waiting = self.given, dict(self.estimates)
        reasons: dict[str, str] = {}
        # An end of a range may only fit once its other end has been put in.
        while waiting:
            before = len(waiting)
            for name, e in list(waiting.items()):
                try:
                    found = found.replace({name: e.value}, {name: e.std}, "identified")
                except InputError as error:
                    reasons[name] = str(error)
                else:
                    del waiting[name]
            if len(waiting) == before:
                break
        for name, e in waiting.items():
            text = f"{e.value:.6g} +- {e.std:.2g} {e.unit} is not given: {reasons[name]}"
            self.notes.append(Finding("warning", name, text, {"value": e.value}))
            del self.estimates[name]
        return found

    def weigh_priors(self, *fits: Experiment | None) -> None:
        """Join what was measured with what was stated of the same number: nothing is less sure than
        it was before. A default that nobody stated is no match for a measurement, which stands with
        its own error. Whole-model fits have weighed the priors already."""
        told = [estimate for fit in fits if fit for estimate in fit.estimates.values()]
        for name, estimate in list(self.estimates.items()):
            prior = Estimate(self.given[name], self.given.std(name), estimate.unit, "given", 0)
            if name not in self.given.given:
                if estimate.std > prior.std and BY_NAME[name].spread is not None:
                    text = (
                        f"measured {estimate.value:.6g} +- {estimate.std:.2g} {estimate.unit}, no "
                        f"surer than such wires differ by (+- {prior.std:.2g})"
                    )
                    self.notes.append(Finding("warning", name, text))
                continue
            if not any(estimate is one for one in told):
                self.estimates[name], remark = with_prior(estimate, prior)
                if remark:
                    self.notes.append(Finding("warning", name, remark))
                elif name in self.given.given_uncertainty and name != AMBIENT:
                    self._surprised(name, estimate, prior)
                self._wonder(name, estimate)
        for name, factor in PRODUCTS.items():
            if name in self.estimates and factor not in self.given.given | self.estimates.keys():
                text = (
                    f"records show only its product with {factor}, which nobody stated: "
                    f"{self.estimates[name].value:.4g} {self.estimates[name].unit} goes with the "
                    f"default, {self.given[factor]:.4g} {BY_NAME[factor].unit}"
                )
                self.notes.append(Finding("warning", name, text))
        if others := self.another_alloy():
            shown = ", ".join(
                f"{n} {self.estimates[n].value:.4g} +- {self.estimates[n].std:.2g} for "
                f"{self.given[n]:.4g} {BY_NAME[n].unit}" for n in others
            )
            text = f"another alloy than the paper's: {shown}; its defaults are not this wire's"
            self.notes.append(Finding("info", "alloy", text, {"contradicted": float(len(others))}))

    def keep_order(self, whole: Experiment | None) -> None:
        """Heating ends above where it begins and above where cooling begins, which begins above
        where it ends: estimates that errors carried past each other meet between. Those that the
        whole model fitted together stay as they are: it keeps the order of either range itself,
        and one of them moved alone would predict another motion."""
        found = {n: e for n, e in self.estimates.items() if n in TRANSITIONS.values()}
        if whole and found and all(e is whole.estimates.get(n) for n, e in found.items()):
            return
        known = {
            n: (self.given[n], self.given.std(n))
            for n in self.given.given.intersection(TRANSITIONS.values())
        }
        known |= {
            n: (self.estimates[n].value, self.estimates[n].std)
            for n in self.estimates.keys() & TRANSITIONS.values()
        }
        before = dict(known)
        for _ in range(_PASSES):
            for lower, upper in _ORDER:
                (low, low_std), (high, high_std) = known.get(lower, _FREE), known.get(upper, _FREE)
                short = low + _NARROWEST - high
                if short > 0.0:
                    share = low_std**2 / max(low_std**2 + high_std**2, 1e-30)
                    known[lower] = low - share * short, low_std
                    known[upper] = high + (1.0 - share) * short, high_std
        for name, (value, std) in known.items():
            moved = value - before[name][0]
            if name in self.estimates and moved:
                self.estimates[name] = replace(self.estimates[name], value=value)
                text = (
                    f"moved by {moved:+.2f} K ({abs(moved) / std:.1f} standard errors), so that "
                    "A_f lies above A_s and M_s, and these above M_f"
                )
                far = abs(moved) > _SIGNIFICANT * std
                self.notes.append(
                    Finding("warning" if far else "info", name, text, {"moved": moved})
                )

    def another_alloy(self) -> list[str]:
        """Numbers of the alloy that nobody stated and whose default the records contradict."""
        found = []
        for name in MATERIAL:
            e, default = self.estimates.get(name), BY_NAME[name]
            if e is not None and name not in self.given.given:
                error = math.hypot(e.std, default.uncertainty or 0.0)
                found += [name] if abs(e.value - self.given[name]) > _SIGNIFICANT * error else []
        return found

    def _surprised(self, name: str, found: Estimate, prior: Estimate) -> None:
        """A surer measurement replaces what was stated, but not without a word."""
        away = (found.value - prior.value) / math.hypot(found.std, prior.std)
        if abs(away) > _SURPRISING:
            text = (
                f"measured {found.value:.6g} +- {found.std:.2g} {found.unit} is {away:+.1f} "
                f"standard errors from the stated {prior.value:.6g} +- {prior.std:.2g}: the "
                "statement, the wire or a sensor is another"
            )
            self.notes.append(Finding("warning", name, text, {"deviations": away}))

    def _wonder(self, name: str, estimate: Estimate) -> None:
        """A camera's spot that is half filled shows in nothing but the size of h and c_p."""
        ratio = estimate.value / self.given[name] if name in _OF_CAMERA else 1.0
        if 1.0 / _WRONG < ratio < _WRONG:
            return
        text = (
            f"{estimate.value:.4g} {estimate.unit} is {ratio:.2g} times the stated "
            f"{self.given[name]:.4g}: another wire or air, or a camera whose spot or emissivity is "
            "off by as much (sensor.temperature.spot_share)"
        )
        self.notes.append(Finding("warning", name, text, {"ratio": ratio}))

    def missing(self, names: Sequence[str]) -> list[str]:
        """The wanted ones of `names` without a result."""
        return [name for name in names if name in self.wanted and not self.of(name)]


# --- What is stated of the wire, against itself.

_DENSITY_STD, _LENGTH_STD = 0.01, 0.005
_BEHIND = {
    "wire.mass": SPECIFIC_HEAT, "wire.surface_area": "wire.heat_transfer_coefficient",
    "wire.diameter": "Theta_T, C_A, C_M",
}


def about_wire(known: Parameters) -> list[Finding]:
    """Mass, area and diameter each tell the diameter of a wire whose length was stated; the one
    that is off makes the number that it is behind as wrong."""
    length = known["wire.length"]
    if not length:
        return []
    doubt = {name: known.std(name) / known[name] for name in _BEHIND}
    diameters = {
        "wire.mass": math.sqrt(4.0 * known["wire.mass"] / (math.pi * NITI_DENSITY * length)),
        "wire.surface_area": known["wire.surface_area"] / (math.pi * length),
        "wire.diameter": known["wire.diameter"],
    }
    error = {
        "wire.mass": 0.5 * math.hypot(doubt["wire.mass"], _DENSITY_STD, _LENGTH_STD),
        "wire.surface_area": math.hypot(doubt["wire.surface_area"], _LENGTH_STD),
        "wire.diameter": doubt["wire.diameter"],
    }

    def agree(one: str, other: str) -> bool:
        apart = abs(math.log(diameters[one] / diameters[other]))
        return apart <= _SIGNIFICANT * math.hypot(error[one], error[other])

    pairs = {name: [n for n in diameters if n != name] for name in diameters}
    if all(agree(*pair) for pair in pairs.values()):
        return []
    odd = [name for name, pair in pairs.items() if agree(*pair)] or list(diameters)
    shown = ", ".join(f"{d * 1e3:.4g} mm by {name}" for name, d in diameters.items())
    return [
        Finding(
            "warning", _BEHIND[name],
            f"the diameter of {length * 1e3:g} mm of wire is {shown}: {name} is wrong, or what "
            "it is compared with, and this number as much",
        )
        for name in odd
    ]


# --- E1 to E3 on bags: which records serve which experiment, and how their results join.

RESISTANCE = "wire.resistance"
COEFFICIENT = "wire.heat_transfer_coefficient"
_SIGNIFICANT, _SMALL = 3.0, 0.01
_SURPRISING = 3.5  # standard errors
_ORDER = tuple(
    (TRANSITIONS[lower], TRANSITIONS[upper])
    for lower, upper in (("A_s", "A_f"), ("M_f", "M_s"), ("M_s", "A_f"), ("M_f", "A_s"))
)
_FREE = (math.nan, 0.0)  # compares with nothing
_NARROWEST, _PASSES = 0.2, 100  # K; of the pairs, which pull at each other
_OF_CAMERA = (COEFFICIENT, SPECIFIC_HEAT)
_WRONG = 1.5  # a factor


def find_all_drives(
    run: IdentificationRun, records: Sequence[Record]
) -> list[tuple[Record, ChannelDrive]]:
    """What every channel of every record is driven with."""
    drives: list[tuple[Record, ChannelDrive]] = []
    for record in records:
        try:
            found = find_drives(record)
        except InputError as error:
            for name in ("E1", "E2", "E3"):
                run.fail(name, str(error))
            continue
        drives.extend((record, drive) for drive in found)
        for drive in found:
            run.notes.extend(missing_findings(record, drive.channel))
    return drives


def _staircases(
    run: IdentificationRun, drives: Sequence[tuple[Record, ChannelDrive]], name: str, quantity: str
) -> list[tuple[Record, Staircase]]:
    """Staircases that come with a signal; the others leave a reason."""
    found: list[tuple[Record, Staircase]] = []
    for record, drive in drives:
        signal = f"{drive.channel}.{quantity}"
        if not drive.staircases:
            run.fail(name, f"{record.path}: {drive.describe()}", meant=False)
        elif not has_samples(record, signal):
            run.fail(name, f"{record.path}: no signal {signal}")
        else:
            found.extend((record, staircase) for staircase in drive.staircases)
    return found


def run_resistance(run: IdentificationRun, drives: Sequence[tuple[Record, ChannelDrive]]) -> None:
    """E1 on every staircase with current."""
    if "E1" not in run.wanted:
        return
    for record, staircase in _staircases(run, drives, "E1", "current"):
        try:
            run.experiments.append(identify_resistance(record, staircase, run.given))
        except InputError as error:
            run.fail("E1", str(error))
    _compare(run, RESISTANCE, [e.estimates[RESISTANCE] for e in run.of("E1")])
    run.join("E1")


def _compare(run: IdentificationRun, parameter: str, found: Sequence[Estimate]) -> None:
    """Whether repeated measurements are of one thing, before they are pooled."""
    if len(found) < 2:
        return
    mean = combine(found).value
    far = max(found, key=lambda e: abs(e.value - mean) / e.statistical)
    apart = abs(far.value - mean) / mean
    if apart < max(_SIGNIFICANT * far.statistical / mean, _SMALL):
        return
    low, high = (100.0 * (end(e.value for e in found) / mean - 1.0) for end in (min, max))
    text = (
        f"{len(found)} staircases lie {low:+.1f} to {high:+.1f} % about their mean, more than "
        "their errors explain: another air flow, another wire or another camera? They were pooled "
        "all the same, with an error that holds the scatter"
    )
    run.notes.append(Finding("warning", parameter, text, {"low": low, "high": high}))


def _heated(run: IdentificationRun) -> Estimate:
    return heated(run.known(RESISTANCE), run.given, RESISTANCE in run.estimates)


def run_heat_transfer(
    run: IdentificationRun, drives: Sequence[tuple[Record, ChannelDrive]]
) -> None:
    """E2 on every staircase with temperature, with the resistance of E1."""
    if "E2" not in run.wanted:
        return
    offsets = {
        e.source: -e.details["intercept"].value / e.details[CHANNEL].value
        for e in run.of("E1")
    }
    for record, staircase in _staircases(run, drives, "E2", "temperature"):
        offset = offsets.get(staircase.source(record), 0.0)
        try:
            experiment = identify_heat_transfer(record, staircase, run.given, _heated(run), offset)
        except InputError as error:
            run.fail("E2", str(error))
            continue
        run.experiments.append(experiment)
    found = run.of("E2")
    if found:
        # The gains are independent of each other; the coefficients share one resistance.
        gains = [e.details[GAIN] for e in found]
        _compare(run, COEFFICIENT, gains)
        gain = combine(gains)
        run.estimates[COEFFICIENT] = coefficient(gain, _heated(run), run.given)
        run.estimates[AMBIENT] = combine([e.estimates[AMBIENT] for e in found])


def run_specific_heat(
    run: IdentificationRun, drives: Sequence[tuple[Record, ChannelDrive]]
) -> None:
    """E3 on all ramps together, with what E1 and E2 gave."""
    if "E3" not in run.wanted:
        return
    usable = []
    for record, drive in drives:
        if not drive.segments.ramps:
            run.fail("E3", f"{record.path}: {drive.describe()}", meant=False)
        elif not has_samples(record, f"{drive.channel}.temperature"):
            run.fail("E3", f"{record.path}: no signal {drive.channel}.temperature")
        else:
            usable.append((record, drive))
    if not usable:
        return
    gains = [e.details[GAIN] for e in run.of("E2")]
    measured = bool(gains) or COEFFICIENT in run.given.given
    default = Estimate(run.given[COEFFICIENT], run.given.std(COEFFICIENT), "", "default", 0)
    heat_loss = HeatLoss(
        _heated(run), run.known(COEFFICIENT) if measured else default,
        combine(gains) if gains else None, known=measured,
    )
    try:
        experiment = identify_specific_heat(usable, run.improved(), heat_loss)
        run.experiments.append(replace(experiment, findings=(*experiment.findings, *_doubts(run))))
    except InputError as error:
        run.fail("E3", str(error))
    run.join("E3")


def _doubts(run: IdentificationRun) -> list[Finding]:
    """What is wrong with the heat loss is wrong with c_p, which goes with it."""
    return [
        Finding("warning", SPECIFIC_HEAT, f"goes with the heat loss, of which E2 says: {f.text}")
        for e in run.of("E2") for f in e.findings
        if f.severity == "warning" and f.subject == COEFFICIENT
    ]
