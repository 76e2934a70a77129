"""The result of an identification as plain facts: what its file holds, and what every card, page
and topic is made from (`templates/identification.j2`)."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from sma_bench.cards import card_html, card_rows, card_text, sentences
from sma_bench.drawn import Reported
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.results import decoded

Array = npt.NDArray[np.float64]
FitVerdict = Literal["ok", "imperfect", "misfit"]
_SURPRISES = 3.0  # standard deviations
_TOGETHER = 0.5  # correlation worth a line


@dataclass(frozen=True)
class SignalFit:
    """How the model fits one signal: `rms` of measured less predicted samples and `noise` of a
    sample, both in `unit`."""

    verdict: FitVerdict
    rms: float
    noise: float
    unit: str


@dataclass(frozen=True, eq=False)
class Correlation:
    """(k, k) correlations of the errors of k numbers."""

    names: tuple[str, ...]
    matrix: Array

    def to_json(self) -> dict[str, Any]:
        """As in the contract, section 5."""
        return {"names": list(self.names), "matrix": np.round(self.matrix, 6).tolist()}


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper as far as the records hold it.

    `estimates` maps parameter names of the contract to what goes into a parameter file;
    `details` holds further numbers (one direction, one heating rate, another method) under
    names of their own; `curves` holds the arrays of its figure, never written to JSON;
    `correlation` is that of the errors of estimates which one fit gave together.
    """

    name: str
    title: str
    estimates: dict[str, Estimate]
    findings: tuple[Finding, ...] = ()
    curves: dict[str, Array] = field(default_factory=dict)
    source: str = ""
    details: dict[str, Estimate] = field(default_factory=dict)
    correlation: Correlation | None = None

    def to_json(self) -> dict[str, Any]:
        """Everything but the curves."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "estimates": {name: e.to_json() for name, e in self.estimates.items()},
            "details": {name: e.to_json() for name, e in self.details.items()},
            "findings": [finding.to_json() for finding in self.findings],
        }


@dataclass(frozen=True, repr=False)
class Identification(Reported):
    """Everything the records gave, or what a result file holds of it.

    `estimates` by parameter name, each with what the parameter file states and the warnings that
    concern it; `parameters` the given ones with these put in, ready for a parameter file (of a
    result file the defaults); `experiments` one each record and channel, with curves; `fit`: how
    the model with these parameters fits every signal that they were identified from; `warnings`:
    everything a careful reader should know before using the numbers; `correlation` of their errors;
    `notes` what could not be identified and why, and what the reader of the records remarked;
    `path` of the result file; `accounts` what became of each record's rows and columns.
    """

    writer = ("collected_report", "write_identification_report")
    template: ClassVar[str] = "identification.j2"

    parameters: Parameters
    estimates: dict[str, Estimate]
    experiments: tuple[Experiment, ...]
    notes: tuple[Finding, ...] = ()
    fit: dict[str, SignalFit] = field(default_factory=dict)
    correlation: Correlation = field(default_factory=lambda: Correlation((), np.empty((0, 0))))
    warnings: tuple[str, ...] = ()
    path: str = "identification"
    accounts: tuple[str, ...] = ()

    def origin(self, name: str) -> str:
        """Name of the experiment that the estimate of a parameter is from, "" of none."""
        holding = [e for e in self.experiments if name in e.estimates]
        taken = self.estimates[name]
        same = [
            e for e in holding
            if (e.estimates[name].value, e.estimates[name].n) == (taken.value, taken.n)
        ]
        return next((e.name for e in (same or holding)[-1:]), "")

    @property
    def is_misfit(self) -> bool:
        """Whether the model misses some signal by more than noise and 5 % of its range."""
        return any(fit.verdict == "misfit" for fit in self.fit.values())

    @property
    def fit_line(self) -> str:
        """Which signals the model misses; "" where it fits all within their noise."""
        return "".join(sentences(self, "fit_line"))

    @property
    def surprising(self) -> dict[str, Estimate]:
        """Numbers that lie far off what the parameter file states."""
        return {n: e for n, e in self.estimates.items() if abs(e.deviations) > _SURPRISES}

    @property
    def linked(self) -> list[tuple[float, str, str]]:
        """Correlations of errors worth a line, the closest first, with the two names."""
        names, matrix = self.correlation.names, self.correlation.matrix
        pairs = [
            (float(matrix[i, j]), names[i], names[j])
            for i in range(len(names)) for j in range(i) if abs(matrix[i, j]) > _TOGETHER
        ]
        return sorted(pairs, key=lambda pair: -abs(pair[0]))

    def __str__(self) -> str:
        """The card: a number a line."""
        return card_text(self)

    def _repr_html_(self) -> str:
        """The card in a notebook."""
        return card_html(self)

    def to_json(self) -> dict[str, Any]:
        """The result file of the contract, section 5."""
        return {
            "parameters": {
                name: {**e.to_json(), "warnings": list(e.warnings)}
                for name, e in self.estimates.items()
            },
            "fit": {name: asdict(one) for name, one in self.fit.items()},
            "card": card_rows(self),
            "correlation": self.correlation.to_json(),
            "experiments": [experiment.to_json() for experiment in self.experiments],
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class _File:
    """A result file as it is written, curves and derived numbers apart."""

    parameters: dict[str, Estimate]
    experiments: tuple[Experiment, ...]
    warnings: tuple[str, ...]
    fit: dict[str, SignalFit] = field(default_factory=dict)
    correlation: dict[str, list[Any]] = field(default_factory=dict)


def identification_from(document: Any, where: str) -> Identification:
    """An identification from what its JSON held.

    Raises:
        InputError: one line that begins with `where` and names the field.
    """
    found = decoded(_File, document, where)
    names, matrix = (found.correlation.get(key, []) for key in ("names", "matrix"))
    try:
        numbers = np.array(matrix, dtype=np.float64).reshape(len(names), len(names))
    except (TypeError, ValueError):
        raise InputError(f"{where}: damaged result: correlation of {len(names)} names is not as "
                         "many rows and columns of numbers") from None
    estimates = {
        name: e if "informed" in document["parameters"][name] else replace(e, informed=np.nan)
        for name, e in found.parameters.items()
    }
    return Identification(
        Parameters.defaults(), estimates, found.experiments, (), found.fit,
        Correlation(tuple(map(str, names)), numbers), found.warnings, where,
    )
