"""One identification under way: what the records gave so far, and why something is missing."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from sma_bench.findings import Finding
from sma_bench.identify.estimate import Estimate, Experiment, combine
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
        """The given parameters with what is identified put in."""
        values = {name: e.value for name, e in self.estimates.items()}
        errors = {name: e.std for name, e in self.estimates.items()}
        return self.given.replace(values, errors, "identified")

    def missing(self, names: Sequence[str]) -> list[str]:
        """The wanted ones of `names` without a result."""
        return [name for name in names if name in self.wanted and not self.of(name)]
