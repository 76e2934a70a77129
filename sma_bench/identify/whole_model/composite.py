"""E10 and E12, composite rig: bending coefficients and wire parameters from its own records."""

from collections.abc import Sequence

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Experiment
from sma_bench.identify.signals import has_samples
from sma_bench.identify.whole_model.fit import fit_experiment
from sma_bench.identify.whole_model.rig_record import rig_record
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, silent
from sma_bench.records.record import Record

NAME = "E10"
TITLE = "Composite rig"


def identify_composite(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """Bending coefficients alpha, beta of each side, and the wire's parameters.

    The baseline model (contract, section 4) is simulated on the measured voltages and held to
    every other signal that the records have: deflection, currents, temperatures. Priors are the
    parameters' values and `uncertainty.`; what the records cannot tell stays there and is named
    in the findings. Records of a single wire in a load frame may join: the same alloy.

    Args:
        records: composite bags, at least one with a deflection (or ranges).
        parameters: the lab's values with their uncertainties, and bench.channels.
        report: told how far the fit is.

    Raises:
        InputError: no voltage of some channel, or no deflection in any record.
    """
    rigs = [rig_record(record, parameters) for record in records]
    if not any("deflection" in rig.quantities for rig in rigs):
        where = ", ".join(str(record.path) for record in records) or "no records"
        raise InputError(f"{where}: no deflection, expected joint_states tip or front/back range")
    return fit_experiment(NAME, TITLE, rigs, parameters, report)


def bends(record: Record) -> bool:
    """Whether a record shows the composite bending."""
    return any(has_samples(record, name) for name in ("deflection", "front.range", "back.range"))
