"""The state of one identification: results so far, and the rules by which they are combined."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.unknowns import MATERIAL, PRODUCTS
from sma_bench.findings import Finding, Severity
from sma_bench.identify.fits import combine
from sma_bench.identify.result import Correlation, Experiment, remark
from sma_bench.identify.signals import AMBIENT, COEFFICIENT, SPECIFIC_HEAT
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, TRANSITIONS
from sma_bench.parameters.parameters import NITI_DENSITY
from sma_bench.results import with_unit

SIGNIFICANT = 3.0  # standard errors by which two numbers differ
_SURPRISING = 3.5  # standard errors from a stated value that are worth a warning
_FAR_APART = 4.0  # standard errors between an experiment and the whole model, likewise
_ORDER = tuple((TRANSITIONS[lower], TRANSITIONS[upper])
               for lower, upper in (("A_s", "A_f"), ("M_f", "M_s"), ("M_s", "A_f"), ("M_f", "A_s")))
_NARROWEST = 0.2  # K between two transition temperatures
_PASSES = 100  # over all pairs, as moving one pair apart may bring another together
_WRONG = 1.5  # ratio of h or c_p to its stated value that points to the camera (a half-filled spot)
_RESULT_WITH = {"wire.mass": SPECIFIC_HEAT, "wire.surface_area": COEFFICIENT,
                "wire.diameter": "Theta_T, C_A, C_M"}  # results computed with each
_DENSITY_STD, _LENGTH_STD = 0.01, 0.005  # relative
_KNOWN = 0.1  # relative error of a factor up to which records can split a product
_ROUNDED = 1.06  # files round errors to two digits: up to this ratio, errors may be the same


@dataclass
class IdentificationRun:
    """Results, remarks, and reasons of failure. `asked`: the user named the experiments."""

    given: Parameters
    wanted: frozenset[str]
    asked: bool = False
    experiments: list[Experiment] = field(default_factory=list)
    estimates: dict[str, Estimate] = field(default_factory=dict)
    notes: list[Finding] = field(default_factory=list)
    reasons: dict[str, list[str]] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)

    def of(self, name: str) -> list[Experiment]:
        return [e for e in self.experiments if e.name == name]

    def attempt(self, name: str, experiment: Callable[[], Experiment]) -> Experiment | None:
        """Run an experiment; None if it is not wanted or fails."""
        if name not in self.wanted:
            return None
        try:
            self.experiments.append(experiment())
        except InputError as error:
            self.fail(name, str(error))
            return None
        return self.experiments[-1]

    def fail(self, name: str, reason: str, meant: bool = True) -> None:
        """Note why a record does not serve an experiment; `meant`: it was made for it."""
        self.reasons.setdefault(name, []).append(reason)
        self.failed |= {name} if meant else set()

    def known(self, name: str) -> Estimate:
        """An identified number, else the given one, with a remark that it was taken."""
        if name in self.estimates:
            return self.estimates[name]
        unit = BY_NAME[name].unit
        prior = Estimate(self.given[name], self.given.std(name), unit, "given")
        cause = "taken from the file" if name in self.given.given else "taken from the table"
        finding = remark(cause, subject=name, prior=prior)
        if finding not in self.notes:
            self.notes.append(finding)
        return prior

    def join(self, name: str) -> None:
        """Add an experiment's estimates, combined over its records, to the results."""
        found = self.of(name)
        for parameter in dict.fromkeys(p for e in found for p in e.estimates):
            own = combine([e.estimates[parameter] for e in found if parameter in e.estimates])
            if other := self.estimates.get(parameter):
                # The later one is closer to the model: calorimeter, loaded wire, joint fit.
                apart = (own.value - other.value) / math.hypot(own.std, other.std)
                cause = "taken instead" if abs(apart) <= SIGNIFICANT else "taken, but far"
                self.notes.append(remark(cause, subject=parameter, own=own, name=name,
                                         deviations=apart, other=other))
            self.estimates[parameter] = own

    def take_sharper(self, whole: Experiment | None) -> None:
        """Where an experiment and the whole model give the same number, keep that of the smaller
        error, not a mean: they may rest on the same samples. Where the experiment took the other
        factor of a product as given, its number is first rescaled to that factor as fitted."""
        found = whole.estimates if whole else {}
        for name, estimate in found.items():
            other = self.estimates.get(name)
            if other is None:
                self.estimates[name] = estimate
                continue
            if factor := found.get(PRODUCTS.get(name, "")):
                times = self.given[PRODUCTS[name]] / factor.value
                shares = {source: times * share for source, share in other.shares.items()}
                shares[PRODUCTS[name]] = -times * other.value * factor.relative_std
                words = f"{other.method}; then {PRODUCTS[name]} is {factor.value:.4g}"
                own = replace(other, value=times * other.value, std=times * other.statistical,
                              systematic=0.0, method=words)
                other = self.estimates[name] = own.with_shares(shares)
            apart = (estimate.value - other.value) / math.hypot(estimate.std, other.std)
            if abs(apart) > _FAR_APART:
                self.notes.append(remark("whole model differs", subject=name, e=estimate,
                                         deviations=apart, other=other))
            if estimate.std < other.std:
                self.estimates[name] = estimate

    def improved(self) -> Parameters:
        """The given parameters updated with the estimates, except those out of their range."""
        found, waiting, reasons = self.given, dict(self.estimates), dict[str, str]()
        if laws := next((e.laws for e in self.experiments if e.laws), ()):
            own = laws[0].fit.parameters
            model = {name: own[name] for name in ("wire.law", "wire.convection")}
            values = {name: e.value for name, e in waiting.items()}
            std = {name: e.std for name, e in waiting.items()}
            with suppress(InputError):  # else one by one, to name those out of range
                return found.replace(model | values, std, "identified")
            found = found.replace(model)
        # A_s may fit only once A_f has been updated: repeat, in case one fits per pass.
        for _ in self.estimates:
            for name, e in list(waiting.items()):
                try:
                    found = found.replace({name: e.value}, {name: e.std}, "identified")
                except InputError as error:
                    reasons[name] = str(error)
                else:
                    del waiting[name]
        for name, e in waiting.items():
            self.notes.append(remark("out of range", subject=name, e=e, value=e.value,
                                     reason=reasons[name]))
            del self.estimates[name]
        return found

    def weigh_priors(self, *fits: Experiment | None) -> None:
        """Combine measured and stated values of a number, so that no error exceeds the stated one.
        A more accurate measurement counts alone; fits of the whole model include the priors."""
        weighed = [estimate for fit in fits if fit for estimate in fit.estimates.values()]
        given, notes = self.given, self.notes
        for name, e in list(self.estimates.items()):
            prior = Estimate(given[name], given.std(name), e.unit, "given")
            if name not in given.given:
                if e.std > prior.std and BY_NAME[name].spread is not None:
                    notes.append(remark("no surer", subject=name, e=e, prior=prior))
                continue
            if any(e is one for one in weighed):
                continue
            away = (e.value - prior.value) / max(math.hypot(e.std, prior.std), 1e-300)
            ratio = e.std / prior.std if prior.std > 0.0 else 0.0
            if ratio > _ROUNDED:
                weight = 1.0 / (1.0 + ratio * ratio)
                std = prior.std * math.sqrt(1.0 - weight)
                value, shares = prior.value + weight * (e.value - prior.value), e.shares.items()
                self.estimates[name] = replace(
                    e, value=value, std=std, method=f"{e.method}, joined with what was known",
                    systematic=min(weight * e.systematic, std), informed=weight,
                    shares={source: weight * share for source, share in shares})
            elif ratio:
                informed = 1.0 - min(ratio, 1.0) ** 2
                self.estimates[name] = replace(e.capped(prior.std), informed=informed)
            stated = name in given.given_uncertainty and name != AMBIENT
            if ratio > _ROUNDED and abs(away) >= SIGNIFICANT:
                notes.append(remark("stated surer", subject=name, e=e, prior=prior, apart=away))
            elif stated and abs(away) > _SURPRISING:  # replaced, with a warning
                notes.append(remark("surprising", subject=name, e=e, prior=prior, deviations=away))
            of_stated = e.value / prior.value if name in (COEFFICIENT, SPECIFIC_HEAT) else 1.0
            if not 1.0 / _WRONG < of_stated < _WRONG:
                lags = name == SPECIFIC_HEAT and of_stated > 1.0
                notes.append(remark("thermometer lags" if lags else "camera off", subject=name,
                                    e=e, ratio=of_stated, prior=prior))
        for name, factor in PRODUCTS.items():
            default = Estimate(given[factor], given.std(factor), BY_NAME[factor].unit)
            other = self.estimates.get(factor, default)
            known = factor in given.given or (other is not default and other.relative_std < _KNOWN)
            if (own := self.estimates.get(name)) and not known:
                notes.append(remark("only a product", subject=name, factor=factor, e=own,
                                    other=other))
        if others := {n: self.estimates[n] for n in self.another_alloy()}:
            each = ", ".join(f"{n} {with_unit(e.unit, e.value, e.std)}" for n, e in others.items())
            notes.append(remark("another alloy", shown=each, contradicted=len(others)))

    def another_alloy(self) -> list[str]:
        """Parameters of the alloy that were not stated and whose default the records contradict."""
        found = {n: e for n, e in self.estimates.items() if n not in self.given.given}
        return [n for n in MATERIAL if (e := found.get(n)) and abs(e.value - self.given[n])
                > SIGNIFICANT * math.hypot(e.std, BY_NAME[n].uncertainty or 0.0)]

    def keep_order(self, whole: Experiment | None) -> None:
        """Move estimates, more the larger their errors, until A_f is above A_s and M_s, and these
        above M_f; not those that the whole model fitted together."""
        found = {n: e for n, e in self.estimates.items() if n in TRANSITIONS.values()}
        if whole and found and all(e is whole.estimates.get(n) for n, e in found.items()):
            return
        stated = self.given.given.intersection(TRANSITIONS.values())
        known = {n: (self.given[n], self.given.std(n)) for n in stated}
        known |= {n: (e.value, e.std) for n, e in found.items()}
        for _ in range(_PASSES):
            for lower, upper in (pair for pair in _ORDER if known.keys() >= {*pair}):
                (low, low_std), (high, high_std) = known[lower], known[upper]
                short = low + _NARROWEST - high
                if short > 0.0:
                    share = low_std**2 / max(low_std**2 + high_std**2, 1e-30)
                    known[lower] = low - share * short, low_std
                    known[upper] = high + (1.0 - share) * short, high_std
        for name, e in found.items():
            if moved := known[name][0] - e.value:
                self.estimates[name] = replace(e, value=known[name][0])
                severity: Severity = "warning" if abs(moved) > SIGNIFICANT * e.std else "info"
                errors = abs(moved) / e.std
                self.notes.append(remark("moved", severity, name, moved=moved, errors=errors))

    def correlation(self) -> Correlation:
        """Correlation of all errors; between experiments, that of systematic errors."""
        names, every = list(self.estimates), list(self.estimates.values())
        matrix = np.eye(len(names))
        for own in self.experiments:
            known = own.correlation.names if own.correlation else ()
            chosen = [(known.index(name), k) for k, name in enumerate(names) if name in known
                      and own.estimates.get(name) == self.estimates[name]]
            if chosen and own.correlation:
                here, there = np.array(chosen).T
                matrix[np.ix_(there, there)] = own.correlation.matrix[np.ix_(here, here)]
        # The statistical part of each error, then the systematic parts of a common source.
        std = np.array([max(e.std, 1e-300) for e in every])
        statistical = np.array([e.statistical for e in every]) / std
        matrix = matrix * np.outer(statistical, statistical)
        for source in sorted({source for e in every for source in e.shares}):
            share = np.array([e.shares.get(source, 0.0) for e in every]) / std
            matrix += np.outer(share, share)
        np.fill_diagonal(matrix, 1.0)
        return Correlation(tuple(names), matrix)


def about_wire(known: Parameters) -> list[Finding]:
    """Findings if the diameters that mass, area and diameter give at this length disagree."""
    if not (length := known["wire.length"]):
        return []
    mass, area, diameter = (known[name] for name in _RESULT_WITH)
    of_mass, of_area, of_diameter = (known.std(name) / known[name] for name in _RESULT_WITH)
    by_mass = math.sqrt(4.0 * mass / (math.pi * NITI_DENSITY * length))
    found = {"wire.mass": (by_mass, 0.5 * math.hypot(of_mass, _DENSITY_STD, _LENGTH_STD)),
             "wire.surface_area": (area / (math.pi * length), math.hypot(of_area, _LENGTH_STD)),
             "wire.diameter": (diameter, of_diameter)}  # m, and its relative error
    # One is odd if the other two agree without it; if no two agree, all are.
    agreeing = []
    for name in found:
        (a, a_std), (b, b_std) = (number for other, number in found.items() if other != name)
        if abs(math.log(a / b)) <= SIGNIFICANT * math.hypot(a_std, b_std):
            agreeing.append(name)
    odd = (agreeing or found) if len(agreeing) < len(found) else ()
    shown = ", ".join(f"{d * 1e3:.4g} mm by {name}" for name, (d, _) in found.items())
    return [remark("wire dimensions disagree", subject=_RESULT_WITH[name], length=length,
                   shown=shown, name=name) for name in odd]
