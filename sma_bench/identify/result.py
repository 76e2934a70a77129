"""The result of an identification as plain facts (rendered by `templates/identification.j2`); the
texts of its remarks, by cause, are in remarks.yaml."""

import string
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from sma_bench.arrays import Array
from sma_bench.border import read_yaml
from sma_bench.drawn import Reported
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding, Severity
from sma_bench.parameters import Parameters
from sma_bench.results import Carded, card_rows, decoded, sentences, with_unit

if TYPE_CHECKING:
    from sma_bench.estimation.laws import Band
    from sma_bench.records.record import Record

FitVerdict = Literal["ok", "imperfect", "misfit"]
_SURPRISES = 3.0  # standard deviations from a stated value
_TOGETHER = 0.5  # correlation worth a line
_WITHIN_NOISE = 1.1  # rms over the noise of a sample, itself known to some 5 %
_USABLE = 0.05  # of the signal's range: largest rms beyond the noise of an imperfect fit


@dataclass(frozen=True)
class SignalFit:
    """How the model fits one signal."""

    verdict: FitVerdict
    rms: float  # of measured less predicted samples, in `unit`
    noise: float  # of a sample, in `unit`
    unit: str

    @classmethod
    def judged(cls, rms: float, noise: float, reach: float, unit: str) -> "SignalFit":
        """`imperfect`: beyond the noise by at most 5 % of `reach`, the range of the signal."""
        verdict: FitVerdict = "ok"
        if rms > _WITHIN_NOISE * noise:
            verdict = "imperfect" if rms**2 - noise**2 <= (_USABLE * reach) ** 2 else "misfit"
        return cls(verdict, rms, noise, unit)

    @property
    def badness(self) -> tuple[int, float]:
        """Sort key: the worst fit last."""
        verdicts = get_args(FitVerdict)
        return verdicts.index(self.verdict), self.rms / self.noise if self.noise else 0.0


@dataclass(frozen=True, eq=False)
class Correlation:
    """(k, k) correlations of the errors of k numbers."""

    names: tuple[str, ...]
    matrix: Array


@dataclass(frozen=True)
class Law:
    """The most probable constitutive law of the wire, its probability and those of the others."""

    name: str
    probability: float
    others: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Experiment:
    """Result of one experiment of the paper."""

    name: str
    title: str
    estimates: dict[str, Estimate]  # by parameter name
    findings: tuple[Finding, ...] = ()
    curves: dict[str, Array] = field(default_factory=dict)  # of its figure, never written to JSON
    source: str = ""
    details: dict[str, Estimate] = field(default_factory=dict)  # further numbers, by other names
    correlation: Correlation | None = None  # of the errors of jointly fitted estimates
    laws: tuple[Any, ...] = ()  # LawFits of the wire, best first; not in result files

    def to_json(self) -> dict[str, Any]:
        """Everything but the curves."""
        return {"name": self.name, "title": self.title, "source": self.source,
                "estimates": {name: e.to_json() for name, e in self.estimates.items()},
                "details": {name: e.to_json() for name, e in self.details.items()},
                "findings": [finding.to_json() for finding in self.findings]}


@dataclass(frozen=True, repr=False)
class Identification(Carded, Reported):
    """Everything identified from records, or read from a result file."""

    writer = ("reports", "write_identification_report")
    template = "identification.j2"

    # the given ones updated with the estimates; the defaults if read from a file
    parameters: Parameters
    estimates: dict[str, Estimate]  # by parameter name, each with its `stated` and `warnings`
    experiments: tuple[Experiment, ...]  # one per record and channel
    notes: tuple[Finding, ...] = ()  # what could not be identified and why, remarks on the records
    fit: dict[str, SignalFit] = field(default_factory=dict)  # of the model, by quantity
    correlation: Correlation = field(default_factory=lambda: Correlation((), np.empty((0, 0))))
    warnings: tuple[str, ...] = ()  # to read before using the numbers
    path: str = "identification"  # of the result file
    accounts: tuple[str, ...] = ()  # what became of each record's rows and columns
    law: Law | None = None  # of the wire, where laws were weighed

    def predict(self, record: "Record", probability: float = 0.9) -> dict[str, "Band"]:
        """Readings that the voltages of a record would give, by signal: the mean over the wire's
        laws, and limits that contain a share `probability` of them. InputError: no moving load
        was identified, `record` lacks a voltage or motion, `probability` is not in 0 to 1."""
        laws = next((e.laws for e in self.experiments if e.laws), ())
        if not laws:
            raise refusal("nothing to predict from")
        from sma_bench.estimation.laws import predict
        from sma_bench.estimation.observation import observe
        return predict(laws, observe(record, laws[0].fit.parameters), probability)

    def origin(self, name: str) -> str:
        """Name of the experiment that a parameter's estimate comes from, or ""."""
        taken = self.estimates[name]
        own = [(e.name, e.estimates[name]) for e in self.experiments if name in e.estimates]
        same = [origin for origin, e in own if (e.value, e.n) == (taken.value, taken.n)]
        return ["", *(origin for origin, _ in own), *same][-1]

    @property
    def is_misfit(self) -> bool:
        """Whether the model misses some signal by more than noise and 5 % of its range."""
        return any(fit.verdict == "misfit" for fit in self.fit.values())

    @property
    def strain_by(self) -> str:
        """The model whose strain `fit` judges, if it is not the paper's law: "by" and its name."""
        last = next((e for e in self.experiments[::-1] if e.name in ("E6", "E9")), None)
        if last is None or last.name == "E6":
            return "by every branch alone" if last else ""
        extended = any(name.startswith("extended") for name in last.details)
        return "by the extended law" if extended else ""

    @property
    def fit_line(self) -> str:
        """Which signals the model misses; "" if it fits all within their noise."""
        return "".join(sentences(self, "fit_line"))

    @property
    def surprising(self) -> dict[str, Estimate]:
        """Estimates far from the values that the parameter file states."""
        return {n: e for n, e in self.estimates.items() if abs(e.deviations) > _SURPRISES}

    @property
    def linked(self) -> list[tuple[float, str, str]]:
        """Correlations of errors worth a line, the closest first, with the two names."""
        names, matrix = self.correlation.names, self.correlation.matrix
        close = np.argwhere(np.abs(np.tril(matrix, -1)) > _TOGETHER)
        pairs = [(float(matrix[i, j]), names[i], names[j]) for i, j in close]
        return sorted(pairs, key=lambda pair: -abs(pair[0]))

    def to_json(self) -> dict[str, Any]:
        """The result file of the contract, section 5."""
        matrix = np.round(self.correlation.matrix, 6).tolist()
        correlation = {"names": list(self.correlation.names), "matrix": matrix}
        return {"parameters": {name: {**e.to_json(), "warnings": list(e.warnings)}
                               for name, e in self.estimates.items()},
                "fit": {name: asdict(one) for name, one in self.fit.items()},
                "card": card_rows(self), "correlation": correlation,
                "experiments": [experiment.to_json() for experiment in self.experiments],
                "warnings": list(self.warnings), **({"law": asdict(self.law)} if self.law else {})}


@dataclass(frozen=True)
class _File:
    """A result file as it is written, except derived numbers."""

    parameters: dict[str, Estimate]
    experiments: tuple[Experiment, ...]
    warnings: tuple[str, ...]
    fit: dict[str, SignalFit] = field(default_factory=dict)
    correlation: dict[str, list[Any]] = field(default_factory=dict)
    law: Law | None = None


def identification_from(document: Any, where: str) -> Identification:
    """An identification from its JSON. InputError: one line with `where` and the field."""
    found = decoded(_File, document, where)
    names, matrix = (found.correlation.get(key, []) for key in ("names", "matrix"))
    try:
        numbers = np.array(matrix, dtype=np.float64).reshape(len(names), len(names))
    except (TypeError, ValueError):
        raise InputError(f"{where}: damaged result: correlation of {len(names)} names, expected "
                         "as many rows and columns of numbers") from None
    estimates = {name: e if "informed" in document["parameters"][name]
                 else replace(e, informed=np.nan) for name, e in found.parameters.items()}
    return Identification(Parameters.defaults(), estimates, found.experiments, (), found.fit,
                          Correlation(tuple(map(str, names)), numbers), found.warnings, where,
                          law=found.law)


class _Words(string.Formatter):
    """As `str.format`; a name may have a factor: {stress/1e6:.0f} MPa, {share*100:+.1f} %. An
    estimate is written with its error and unit."""

    def get_field(self, field: str, args: Sequence[Any], facts: Mapping[str, Any]) -> Any:
        field, _, divisor = field.partition("/")
        field, _, factor = field.partition("*")
        value, name = super().get_field(field, args, facts)
        if factor or divisor:
            value = value * float(factor or 1.0) / float(divisor or 1.0)
        return value, name

    def format_field(self, value: Any, spec: str) -> str:
        if isinstance(value, Estimate):
            return with_unit(value.unit, value.value, value.std)
        return str(super().format_field(value, spec))


_entries = cache(lambda: read_yaml(Path(__file__).with_name("remarks.yaml")))


def words(cause: str, **facts: object) -> str:
    """The text of a cause with these facts in it."""
    return _Words().vformat(_entries()[cause]["text"], (), facts)


def refusal(cause: str, **facts: object) -> InputError:
    """The error of a cause, with these facts in its text."""
    return InputError(words(cause, **facts))


def remark(cause: str, severity: Severity | None = None, subject: str = "",
           numbers: Mapping[str, float] | None = None, **facts: Any) -> Finding:
    """The remark of a cause, its facts in SI units. `severity`, `subject`: other than the table's;
    `numbers`: for machines, else the facts that the table lists."""
    entry = _entries()[cause]
    severity, subject = severity or entry.get("severity", "info"), subject or entry["subject"]
    if numbers is None:
        numbers = {name: float(facts[name]) for name in entry.get("numbers", ())}
    return Finding(severity, subject, words(cause, subject=subject, **facts), dict(numbers))
