"""Fit of the whole model to any set of rig records, as an experiment."""

from collections.abc import Sequence

from sma_bench.identify.estimate import Experiment
from sma_bench.identify.whole_model import fit_report
from sma_bench.identify.whole_model.output_error import fit_bench
from sma_bench.identify.whole_model.prior import BENDING, HEAT, MATERIAL, SECTION
from sma_bench.identify.whole_model.rig_record import RigRecord
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, silent

_METHOD = "simulation fitted to {quantities}"


def fit_experiment(
    name: str, title: str, rigs: Sequence[RigRecord], parameters: Parameters,
    report: Report = silent,
) -> Experiment:
    """Fit everything that the records can depend on, and report it."""
    names = [*HEAT]
    mechanical = any(rig.holds or "deflection" in rig.quantities for rig in rigs)
    names += MATERIAL if mechanical else ()
    names += BENDING if any("deflection" in rig.quantities for rig in rigs) else ()
    names += SECTION if any(rig.holds for rig in rigs) else ()
    fit = fit_bench(rigs, parameters, names, report)
    quantities = list(dict.fromkeys(q for rig in rigs for q in rig.quantities))
    method = _METHOD.format(quantities=", ".join(quantities))
    return Experiment(
        name, title, fit_report.estimates(fit, method), fit_report.findings(fit),
        fit_report.curves(fit), "; ".join(str(rig.record.path) for rig in rigs),
        fit_report.products(fit),
    )
