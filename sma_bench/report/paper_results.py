"""What the figures and tables of the paper are drawn from: records in, experiments out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify import identify
from sma_bench.identify.estimate import Estimate, Experiment
from sma_bench.identify.instruments.heating_rates import identify_heating_rates
from sma_bench.identify.instruments.isobaric import identify_isobaric
from sma_bench.identify.instruments.tensile import identify_tensile
from sma_bench.identify.instruments.thermal_expansion import identify_thermal_expansion
from sma_bench.parameters import Parameters
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.record import Record
from sma_bench.records.tensile import TensileRecord

THERMAL = ("E1", "E2", "E3")
# One wire record need not hold all three; the first choice that it holds counts.
_THERMAL_CHOICES = (THERMAL, ("E1", "E2"), ("E3",), ("E1",), ("E2",))


@dataclass(frozen=True)
class LabRecords:
    """Records of a laboratory, sorted by what they are good for.

    Attributes:
        thermal: E1 to E3, voltage staircases and ramps below A_s of one wire.
        validation: E4, voltages that no parameter is fitted to.
        dsc: E5; upfr: E6 at one low load; isobaric: E6 at several loads; tensile: E7;
        clamped: E8, a wire between clamps with its force.
        composite: E12.
    """

    thermal: tuple[Record, ...] = ()
    validation: tuple[Record, ...] = ()
    dsc: tuple[DscRecord, ...] = ()
    upfr: tuple[IsobaricRecord, ...] = ()
    isobaric: tuple[IsobaricRecord, ...] = ()
    tensile: tuple[TensileRecord, ...] = ()
    clamped: tuple[Record, ...] = ()
    composite: tuple[Record, ...] = ()

    def only(self, names: Sequence[str]) -> "LabRecords":
        """These groups and no others."""
        return LabRecords(**{f.name: getattr(self, f.name) for f in fields(self)
                             if f.name in names})


@dataclass(frozen=True)
class Outcome:
    """Results of one kind of experiment.

    `experiments` one a record, `estimates` joined over them, `synthetic` whether the records are.
    """

    experiments: tuple[Experiment, ...]
    estimates: dict[str, Estimate]
    synthetic: bool


# Kinds of experiment by the group of records that feeds them.
KINDS = {
    "thermal": THERMAL,
    "dsc": ("E5",),
    "upfr": ("E6",),
    "isobaric": ("E6 stresses",),
    "tensile": ("E7",),
    "clamped": ("E8",),
}


def identify_lab(
    records: LabRecords, parameters: Parameters, *, synthetic: bool
) -> tuple[dict[str, Outcome], list[Finding]]:
    """Run every experiment that the records allow.

    Args:
        parameters: what is known beforehand.
        synthetic: whether the records are.

    Returns:
        Outcomes by kind ("E1" to "E3", "E5" to "E8", "E6 stresses"), and why others are missing.
    """
    found: dict[str, Outcome] = {}
    notes: list[Finding] = []
    if records.thermal:
        found.update(_thermal(records.thermal, parameters, synthetic, notes))
    wanted: tuple[tuple[str, Sequence[object], Callable[[], Experiment]], ...] = (
        ("E5", records.dsc, lambda: identify_heating_rates(records.dsc)),
        ("E6", records.upfr, lambda: identify_isobaric(records.upfr, parameters)),
        (
            "E6 stresses", records.isobaric,
            lambda: identify_isobaric(records.isobaric, parameters, temperatures="cosine"),
        ),
        ("E7", records.tensile, lambda: identify_tensile(records.tensile, parameters)),
        ("E8", records.clamped, lambda: _thermal_expansion(records.clamped, parameters)),
    )
    for kind, given, run in wanted:
        if not given:
            continue
        try:
            experiment = run()
        except InputError as error:
            notes.append(Finding("warning", kind, str(error)))
        else:
            found[kind] = Outcome((experiment,), experiment.estimates, synthetic)
    return found, notes


def _thermal(
    records: Sequence[Record], parameters: Parameters, synthetic: bool, notes: list[Finding]
) -> dict[str, Outcome]:
    reasons: list[str] = []
    for choice in _THERMAL_CHOICES:
        try:
            result = identify(records, parameters, choice)
        except InputError as error:
            reasons.append(str(error))
            continue
        notes.extend(note for note in result.notes if note.severity != "info")
        return {kind: _outcome(result.experiments, result.estimates, kind, synthetic)
                for kind in choice}
    notes.append(Finding("warning", "E1 to E3", reasons[0]))
    return {}


def _thermal_expansion(records: Sequence[Record], parameters: Parameters) -> Experiment:
    channel = records[0].channels[0]
    return identify_thermal_expansion(
        records, parameters, temperature=f"{channel}.temperature"
    )


def _outcome(
    experiments: Sequence[Experiment], estimates: Mapping[str, Estimate], kind: str,
    synthetic: bool,
) -> Outcome:
    mine = tuple(e for e in experiments if e.name == kind)
    names = {name for e in mine for name in e.estimates}
    return Outcome(mine, {n: e for n, e in estimates.items() if n in names}, synthetic)


def identified_parameters(parameters: Parameters, outcomes: Sequence[Outcome]) -> Parameters:
    """The given parameters with what the outcomes identified put in."""
    estimates = {name: e for outcome in outcomes for name, e in outcome.estimates.items()}
    return parameters.replace(
        {name: e.value for name, e in estimates.items()},
        {name: e.std for name, e in estimates.items()},
        "identified",
    )
