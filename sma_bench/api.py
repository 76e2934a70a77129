"""The functions of `import sma_bench`, for notebooks: those of commands and nodes, with arrays.

Everything is in SI units (K, V, A, m, Pa, s). Wrong input raises `InputError`, a ValueError with a
message of one line. Nothing is computed here: see the packages imported below."""

import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose import diagnose as _diagnose
from sma_bench.errors import InputError, errors_in
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.identify import Identification
from sma_bench.identify import identify as _identify
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import load_kind
from sma_bench.parameters.yaml_file import flatten
from sma_bench.physics import Simulation
from sma_bench.physics.effects import with_effect
from sma_bench.protocols import load_protocol, parse_protocol, protocol_names
from sma_bench.records import Record, Signal, open_record, open_records
from sma_bench.records import record as recording
from sma_bench.records.bag_writer import write_record
from sma_bench.records.import_map import record_of_table
from sma_bench.records.open import AnyRecord
from sma_bench.records.overlay import Overlay, overlay
from sma_bench.synthetic import bench_records

__all__ = ["Diagnosis", "Identification", "InputError", "Overlay", "Parameters", "Record", "Signal",
           "Simulation", "compare", "diagnose", "identify", "load", "load_parameters", "measure",
           "simulate", "to_frame", "write_parameters", "write_record"]


def load(source: Any, namespace: str | None = None, *, units: Mapping[str, str] | None = None,
         params: str | Path | None = None) -> AnyRecord:
    """One record: `record["wire.voltage"]` has `time` (n,) s and `values` (n,).

    Args:
        source: path of a bag or of an instrument file (a record of its own kind); a mapping of
            contract names (`wire.voltage`) to arrays (n,) in SI units on the shared clock `time`
            (n,) s, or to pairs (time, values); a pandas DataFrame with such columns; a simulation,
            read without noise; or a record, returned as it is.
        namespace: which bench to use, if the bag holds two.
        units: of the columns of a logger's table, by name.
        params: the rig's parameter file, for a logger's table.

    Raises InputError: not readable, or arrays of different lengths."""
    if isinstance(source, AnyRecord):
        return source
    if isinstance(source, Simulation):
        return _recorded(bench_records.signals_of(source), "simulation")
    if all(hasattr(source, name) for name in ("columns", "index", "to_numpy")):  # of pandas
        return recording.record_from_frame(source)
    if isinstance(source, Mapping):
        return recording.record_from_arrays(source)
    if not isinstance(source, str | Path):
        raise InputError(f"load: {type(source).__name__} given, expected a path, a mapping of "
                         "arrays, a DataFrame, a simulation or a record")
    if units is None and params is None:
        return open_record(source, namespace)
    return record_of_table(source, load_parameters(params), units or {})


def load_parameters(source: Any = None) -> Parameters:
    """Parameters of a bench, each with its uncertainty. `source`: path of a ROS 2 parameter file; a
    mapping of names to values, flat (`{"wire.resistance": 2.8, "uncertainty.wire.resistance":
    0.02}`) or nested; None for the defaults; or parameters, returned as is. Raises InputError:
    unreadable file, unknown name, wrong type or a value out of its range."""
    if isinstance(source, Parameters):
        return source
    if source is None:
        return Parameters.defaults()
    if isinstance(source, Mapping):
        return Parameters(flatten(source))
    if isinstance(source, str | Path):
        return read_parameters(source)
    raise InputError(f"parameters: {type(source).__name__} given, expected a path, a mapping or "
                     "Parameters")


def simulate(drive: Any, parameters: Any = None, *, effects: Mapping[str, float] | None = None,
             rate: float = 100.0) -> Simulation:
    """Simulate the paper's model, with effects if switched on, for given voltages.

    Args:
        drive: name of a protocol, path of its file, or the mapping of such a file (`steps`); time
            (n,) s and voltage (n, w) V, one column per channel, each held to the next sample, and
            third, for `load.kind` displacement, the imposed elongation (n,) m; or anything that
            `load` takes: its measured voltages are used, also above the bench's limit.
        parameters: as for `load_parameters`; `bench.channels` defines the rig.
        effects: size by name, `{"latent_heat": 12e3}`; other numbers by `name.number`.
        rate: samples per second of a protocol.

    The simulation has `time` (n,) s, `voltage`, `current`, `temperature`, `martensite_fraction`,
    `stress` (n, w), `deflection` (n,) m. Raises InputError: unknown protocol or effect, an effect
    impossible with the load, wrong shapes, a voltage above the limit."""
    bench = load_parameters(parameters)
    for name, size in (effects or {}).items():
        with errors_in(f"effects: {name}"):
            bench = with_effect(bench, name, size)
    protocol, is_path = None, isinstance(drive, str | Path)
    if is_path and (drive in protocol_names() or Path(drive).suffix == ".yaml"):
        protocol = load_protocol(drive, bench)
    elif isinstance(drive, Mapping) and "steps" in drive:
        protocol = parse_protocol(drive, bench)
    arrays = len(drive) if isinstance(drive, tuple) else 0
    if (protocol or arrays == 2) and load_kind(bench) == "displacement":
        warnings.warn("simulate: no motion is imposed, the elongation is held at 0", stacklevel=2)
    if protocol:
        if not 0.0 < rate <= 10_000.0:
            raise InputError(f"simulate: rate is {rate:g} Hz, expected 0 to 10000")
        return bench_records.simulate_protocol(protocol, bench, 1.0 / rate)
    if isinstance(drive, tuple):
        if arrays not in (2, 3):
            raise InputError(f"simulate: {arrays} arrays given, expected time and voltage")
        try:
            highest = np.abs(np.asarray(drive[1], dtype=np.float64)).max(initial=0.0)
        except (TypeError, ValueError):
            raise InputError("simulate: voltage: expected an array of numbers") from None
        if highest > (limit := bench["bench.maximum_voltage"]):
            raise InputError(f"simulate: voltage is {highest:g} V, expected at most {limit:g} V")
        return bench_records.simulate_finely(bench, *drive)
    if isinstance(drive, str) and not os.path.exists(drive):
        raise InputError(f"simulate: {drive}: neither a bag nor a protocol, expected one of "
                         f"{', '.join(protocol_names())}")
    (record,) = _bags([load(drive)])
    return bench_records.simulate_finely(*recording.drive_of(record, bench))


def measure(simulation: Simulation, seed: int = 1) -> Record:
    """A synthetic record: a simulation read by the sensors of the simulator node. The same `seed`
    (0 or more) gives the same noise. InputError: not a simulation, or a wrong seed."""
    if not isinstance(simulation, Simulation):
        raise InputError(f"measure: {type(simulation).__name__} given, expected a simulation")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"measure: seed is {seed!r}, expected a whole number of 0 or more")
    signals = bench_records.signals_of(simulation)
    return _recorded(bench_records.read_signals(signals, seed), "synthetic record")


def identify(records: Any, parameters: Any = None,
             experiments: Iterable[str] | None = None) -> Identification:
    """Identify parameters, with standard errors, from records.

    Args:
        records: anything that `load` takes, or a list of such; all are combined.
        parameters: what is known beforehand (mass, area, ...), as for `load_parameters`.
        experiments: one of E0 to E10, or several; all that the records allow when None.

    The result has `estimates` by name, with `value`, `std`, `unit`, and the updated `parameters`.
    Raises InputError: nothing to identify, or an experiment that the records do not allow."""
    wanted = [experiments] if isinstance(experiments, str) else experiments
    return _identify(_records(records), load_parameters(parameters), wanted)


def diagnose(records: Any, parameters: Any = None, hold_out: Any = (), *,
             signals: Sequence[str] = QUANTITIES) -> Diagnosis:
    """Find where bench and model disagree, which effect causes it, and how far the gap shrinks.

    Args:
        records: of one bench: anything that `load` takes, or a list of such.
        parameters: as stated, with `uncertainty.NAME` as priors; as for `load_parameters`.
        hold_out: records to measure the shrinkage on; if empty, the last part of each record.
        signals: quantities to compare, of current, temperature, deflection.

    The result has `verdict`, `cause`, `candidates`, `where`, `shrinkage`, `improved` parameters,
    `to_json()`. Raises InputError: no record, an instrument file, or nothing to compare."""
    signals = (signals,) if isinstance(signals, str) else signals
    if unknown := sorted(set(signals) - set(QUANTITIES)):
        raise InputError(f"diagnose: signals {unknown[0]!r}, expected some of {list(QUANTITIES)}")
    seen, unseen = (_bags(_records(given)) for given in (records, hold_out))
    return _diagnose(seen, load_parameters(parameters), unseen, quantities=signals)


def compare(records: Any, models: Any = ()) -> Overlay:
    """Overlay records and models: clocks aligned by the voltages, differences in numbers.

    Args:
        records: anything that `load` takes, a list of such, or a mapping of names to such; the
            others are compared with the first.
        models: parameters (as for `load_parameters`), a list or a mapping of names to such; each
            is simulated with the voltages of the first record.

    `differences` has the largest first; `print` shows a table, `plot()` a figure. Raises
    InputError: fewer than two in all, or no signal in common."""

    def named(given: Any, kind: str) -> dict[str, Any]:
        """Records or models by name: the given name, that of the file, or a number."""
        groups = {"uncertainty", *(name.partition(".")[0] for name in BY_NAME)}
        things = str | Path | Record | Parameters | Simulation
        if isinstance(given, Mapping) and not set(given) & set(BY_NAME) and all(
                isinstance(v, things) or hasattr(v, "columns")
                or (isinstance(v, Mapping) and name not in groups) for name, v in given.items()):
            return dict(given)  # otherwise the mapping is itself one record or model
        found: dict[str, Any] = {}
        for k, thing in enumerate(given if isinstance(given, list | tuple) else [given], 1):
            path = thing if isinstance(thing, str | Path) else getattr(thing, "path", "")
            name = Path(path).name or f"{kind} {k}"
            found[name if name not in found else f"{name} ({k})"] = thing
        return found

    given = named(records, "record")
    if not given:
        raise InputError("compare: no record, expected at least one")
    shown = dict(zip(given, _bags([load(one) for one in given.values()]), strict=True))
    first = next(iter(shown.values()))
    modelled: dict[str, Record] = {}
    for name, model in named(models, "model").items():
        bench = load_parameters(model)
        if not modelled:  # correct the readings by the sensor calibration of the first model
            shown = {key: recording.as_calibrated(record, bench) for key, record in shown.items()}
        drive = recording.drive_of(first, recording.with_stated_lag(bench))
        run = bench_records.simulate_finely(*drive)
        own = name if name not in shown else f"{name} (model)"
        modelled[own] = _recorded(bench_records.signals_of(run), name)
    return overlay(shown | modelled, tuple(modelled))


def to_frame(thing: Any) -> Any:
    """A pandas DataFrame. Of a record (anything that `load` takes): a column per signal, index
    `time` in s, units in `attrs["units"]`, NaN where a signal has no sample; `load` reads such a
    frame. Of an identification: a row per parameter. Of a diagnosis: a row per candidate. Raises
    InputError: pandas is not installed, or `thing` has no table."""
    rows: dict[str, dict[str, Any]] = {}
    if isinstance(thing, Identification):
        index = "parameter"
        for name, e in thing.estimates.items():
            rows[name] = {"value": e.value, "std": e.std, "unit": e.unit, "n": e.n,
                          "method": e.method, "experiment": thing.origin(name)}
    elif isinstance(thing, Diagnosis):
        index, columns = "candidate", ("probability", "stage", "gap_over_noise", "log_evidence")
        for candidate in thing.to_json()["candidates"]:
            rows[candidate["name"]] = {name: candidate[name] for name in columns}
    else:
        (record,) = _bags([load(thing)])
        return recording.frame_from_record(record)
    frame = recording.require_pandas().DataFrame.from_dict(rows, orient="index")
    frame.index.name = index
    return frame


def _recorded(signals: Sequence[Signal], name: str) -> Record:
    return Record(Path(name), 0, {signal.name: signal for signal in signals})


def _records(given: Any) -> list[AnyRecord]:
    """All records of the sources; a workbook has one per sheet."""
    records: list[AnyRecord] = []
    for source in given if isinstance(given, list | tuple) else [given]:
        records += open_records(source) if isinstance(source, str | Path) else [load(source)]
    return records


def _bags(records: Sequence[AnyRecord]) -> list[Record]:
    for record in records:
        if not isinstance(record, Record):
            raise InputError(f"{record.path}: an instrument file, expected a record of a bench")
    return [record for record in records if isinstance(record, Record)]
