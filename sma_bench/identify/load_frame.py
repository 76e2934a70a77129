"""E6 to E9 on the wire rig with a load frame: constitutive parameters from its bags.

Isobaric heating and cooling at several held loads tells eps_L, the transition temperatures, C_A,
C_M and both moduli; a staircase of the clamped wire below A_s tells Theta_T. The wire is heated by
its own current, so the thermal parameters come along.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.load_frame import find_pulls, has_load_frame, is_clamped
from sma_bench.estimation.noise_model import Array
from sma_bench.estimation.observation import find_rig
from sma_bench.findings import Finding
from sma_bench.identify.instruments.isobaric import identify_isobaric
from sma_bench.identify.instruments.tensile import about_length
from sma_bench.identify.result import Experiment
from sma_bench.identify.whole_model import fit_experiment, observe_all
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length
from sma_bench.physics.bending import wire_section
from sma_bench.progress import Report, silent
from sma_bench.records.isobaric import IsobaricRecord, find_cycles
from sma_bench.records.record import Record, has_samples, samples
from sma_bench.records.tensile import FEWEST_ROWS, STEADY, TensileRecord

NAME = "E9"
TITLE = "Constitutive parameters from the load frame"
_SHORTEST_TEST = 10.0
_FAR = 4.0
_SMALLEST_RANGE = 5.0
_ROWS = 60


def identify_load_frame(
    records: Sequence[Record], parameters: Parameters, report: Report = silent
) -> Experiment:
    """Thermal and constitutive parameters of one wire.

    The whole model is simulated on the measured voltage under the loads that were held, or
    between the clamps, and held to elongation or force, temperature and current (see
    `identify_moving_bench`). E6 on the same loops, branch by branch, stands beside it in
    `details` ("E6.<parameter>").

    Args:
        records: bags of one wire with `elongation`, `force` or both.
        parameters: the lab's values with their uncertainties; mass and diameter tell the wire's
            length (NiTi, 6450 kg/m3), for which the contract has no parameter.
        report: called with how far the fit is.

    Raises:
        InputError: no load frame in any record, no voltage, or neither held loads nor clamps.
    """
    observations = observe_all(records, parameters)
    if not any(one.holds for one in observations):
        where = ", ".join(str(record.path) for record in records) or "no records"
        raise InputError(
            f"{where}: no load frame, expected joint_states wire with position or effort"
        )
    fitted = fit_experiment(NAME, TITLE, observations, parameters, report)
    beside, remarks = _branch_by_branch(records, parameters, fitted)
    return replace(
        fitted, details={**fitted.details, **beside},
        findings=(*fitted.findings, about_length(parameters), *remarks),
    )


def isobaric_tests(record: Record, parameters: Parameters) -> tuple[IsobaricRecord, ...]:
    """The loops of a load-frame bag as isobaric tests, one a held load.

    Strain is elongation over the wire's length, stress is force over its section.

    Raises:
        InputError: no voltage, temperature or elongation.
    """
    rig = find_rig(record, parameters)
    time, elongation = samples(record, "elongation")
    kelvin = np.interp(time, *samples(record, f"{rig.channels[0]}.temperature"))
    tests: list[IsobaricRecord] = []
    for hold in rig.holds:
        start, stop = hold.start, hold.stop
        inside = (time >= start) & (time <= stop)
        if hold.clamped or stop - start < _SHORTEST_TEST:
            continue
        if np.ptp(kelvin[inside]) < _SMALLEST_RANGE:
            continue
        stress = hold.value / wire_section(parameters)
        name = f"{record.path.name} {stress / 1e6:.0f} MPa"
        cycles, remarks = find_cycles(
            kelvin[inside], elongation[inside] / wire_length(parameters),
            np.full(int(inside.sum()), stress), name,
        )
        tests.append(IsobaricRecord(record.path, name, stress, "1", tuple(cycles), tuple(remarks)))
    return tuple(tests)


def tensile_tests(record: Record, parameters: Parameters) -> tuple[TensileRecord, ...]:
    """The pulls of a load-frame bag at steady temperature as tensile tests, one a pull.

    A row is a mean over a part of the pull: what an extensometer scatters within one would make
    the wire look softer.
    """
    thermometer = _thermometer(record)
    if thermometer is None or not all(has_samples(record, n) for n in ("elongation", "force")):
        return ()
    tests = []
    for number, (start, stop) in enumerate(find_pulls(record), 1):
        edges = np.linspace(start, stop, _ROWS + 1)
        elongation, force = (
            _means_within(*samples(record, name), edges) for name in ("elongation", "force")
        )
        known, kelvin = np.isfinite(elongation + force), None
        if known.sum() < FEWEST_ROWS:
            continue
        if thermometer:
            read = _means_within(*samples(record, thermometer), edges)
            if np.nanmax(read) - np.nanmin(read) > STEADY:
                continue
            kelvin = float(np.nanmean(read))
        tests.append(TensileRecord(
            record.path / f"pull {number}", elongation[known] / wire_length(parameters),
            force[known] / wire_section(parameters), kelvin,
        ))
    return tuple(tests)


def _thermometer(record: Record) -> str | None:
    """What tells the temperature of a pull: the wire's, else the room's where nothing heats it;
    empty if nobody measured either, None if the wire may have any temperature."""
    if len(record.channels) > 1:
        return None
    for channel in record.channels:
        if has_samples(record, f"{channel}.temperature"):
            return f"{channel}.temperature"
        if any(has_samples(record, f"{channel}.{q}") for q in ("voltage", "current")):
            return None
    return "ambient.temperature" if has_samples(record, "ambient.temperature") else ""


def _means_within(time: Array, values: Array, edges: Array) -> Array:
    """(m,) means between (m + 1,) times; NaN where nothing was measured."""
    index = np.searchsorted(edges, time, side="right") - 1
    inside = (index >= 0) & (index < len(edges) - 1)
    count = np.bincount(index[inside], minlength=len(edges) - 1)
    total = np.bincount(index[inside], values[inside], len(edges) - 1)
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)


def holds_frame(record: Record) -> bool:
    """Whether a record can be used by `identify_load_frame`."""
    channels = record.channels
    return (
        len(channels) == 1 and has_load_frame(record)
        and has_samples(record, f"{channels[0]}.voltage")
    )


def holds_loads(record: Record) -> bool:
    """Whether the frame lets the wire move: loads are held, not the clamps."""
    return not is_clamped(record)


def is_clamped_wire(record: Record) -> bool:
    """Whether one wire was clamped while its force and temperature were measured."""
    if len(record.channels) != 1 or not is_clamped(record):
        return False
    names = ("force", f"{record.channels[0]}.temperature")
    return all(has_samples(record, name) for name in names)


def stays_cold(record: Record, parameters: Parameters) -> bool:
    """Whether the wire stays below A_s.

    A clamped wire that is heated above it pulls with stresses that no real wire bears: what its
    force says of the transformation is better not mixed with held loads.
    """
    name = f"{record.channels[0]}.temperature"
    limit = float(parameters["wire.austenite_start_temperature"])
    return has_samples(record, name) and bool(np.percentile(samples(record, name)[1], 99.0) < limit)


def _branch_by_branch(
    records: Sequence[Record], parameters: Parameters, fitted: Experiment
) -> tuple[dict[str, Estimate], list[Finding]]:
    tests: list[IsobaricRecord] = []
    for record in records:
        if not is_clamped(record) and has_samples(record, f"{record.channels[0]}.temperature"):
            tests += isobaric_tests(record, parameters)
    if not tests:
        return {}, []
    try:
        drawn = identify_isobaric(tests, parameters)
    except InputError as error:
        return {}, [Finding("warning", "E6", str(error))]
    remarks = []
    for name, estimate in drawn.estimates.items():
        other = fitted.estimates.get(name)
        if other is None:
            continue
        apart = (estimate.value - other.value) / np.hypot(estimate.std, other.std)
        if abs(apart) > _FAR:
            text = (
                f"E6 gives {estimate.value:.5g} +- {estimate.std:.2g} {estimate.unit}, "
                f"{apart:+.1f} standard errors from the fit: the loops are not the model's cosines"
            )
            remarks.append(Finding("warning", name, text, {"deviations": float(apart)}))
    return {f"E6.{name}": e for name, e in drawn.estimates.items()}, remarks
