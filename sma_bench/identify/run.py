"""One identification under way: what the records gave so far, and why something is missing."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Estimate, Experiment, combine, with_prior
from sma_bench.parameters import Parameters


@dataclass
class Run:
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

    def of(self, name: str) -> list[Experiment]:
        """Experiments done under this name."""
        return [e for e in self.experiments if e.name == name]

    def fail(self, name: str, reason: str) -> None:
        """Note why a record gave nothing to an experiment."""
        self.reasons.setdefault(name, []).append(reason)

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
            self.estimates[parameter] = combine(
                [e.estimates[parameter] for e in found if parameter in e.estimates]
            )

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

    def weigh_priors(self, whole: Experiment | None) -> None:
        """Nothing is less sure than it was before: where an experiment of its own says less of a
        number than was known, both count. The whole model has weighed the priors already."""
        for name, estimate in self.estimates.items():
            if whole is not None and estimate is whole.estimates.get(name):
                continue
            prior = Estimate(self.given[name], self.given.std(name), estimate.unit, "given", 0)
            self.estimates[name], remark = with_prior(estimate, prior, name in self.given.given)
            if remark:
                self.notes.append(Finding("warning", name, remark))

    def missing(self, names: Sequence[str]) -> list[str]:
        """The wanted ones of `names` without a result."""
        return [name for name in names if name in self.wanted and not self.of(name)]
