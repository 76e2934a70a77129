"""What `import sma_bench` gives a notebook: the commands' and nodes' own functions on arrays.

Everything is in SI units (K, V, A, m, Pa, s). Whatever a user can get wrong raises `InputError`, a
ValueError of one line. Nothing is computed here: see the room that each function names.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose import diagnose as _diagnose
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.identify import Identification
from sma_bench.identify import identify as _identify
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.node_tables import node_groups
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.yaml_file import flatten, read_parameter_names, split_names
from sma_bench.physics import Simulation
from sma_bench.physics.effects import effect_values
from sma_bench.protocols import Protocol, load_protocol, parse_protocol, protocol_names
from sma_bench.records import Record, Signal, open_record, open_records
from sma_bench.records.arrays import (
    frame_from_record,
    is_frame,
    record_from_arrays,
    record_from_frame,
    require_pandas,
)
from sma_bench.records.bag_writer import write_record
from sma_bench.records.dsc import DscRecord
from sma_bench.records.import_proposal import BenchHints, bench_of, record_of_table
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.overlay import Overlay, overlay
from sma_bench.records.samples import drive_of
from sma_bench.records.tensile import TensileRecord
from sma_bench.synthetic.bench_records import (
    read_signals,
    signals_of,
    simulate_finely,
    simulate_protocol,
)

__all__ = [
    "Diagnosis",
    "Identification",
    "InputError",
    "Overlay",
    "Parameters",
    "Record",
    "Signal",
    "Simulation",
    "compare",
    "diagnose",
    "identify",
    "load",
    "load_parameters",
    "measure",
    "simulate",
    "to_frame",
    "write_parameters",
    "write_record",
]

_READ = (Record, DscRecord, IsobaricRecord, TensileRecord)


def load(
    source: Any, namespace: str | None = None, *, units: Mapping[str, str] | None = None,
    params: str | Path | None = None,
) -> AnyRecord:
    """One record: named signals, each with its unit and its own clock (`records/`).

    Args:
        source: path of a bag (folder, .mcap, .db3) or of an instrument file (DSC, isobaric,
            tensile); a mapping of contract names (`wire.voltage`) to arrays (n,) in SI units on
            the shared clock `time` (n,) s, or to pairs (time, values); a pandas DataFrame with
            such columns; a simulation, which is then read exactly; a record as it is.
        namespace: where two benches are in one bag, the one to take.
        units: of a logger's table, by column where titles do not tell; it is then read as
            `sma-bench import` reads it.
        params: the rig's parameter file for such a table.

    Returns:
        `Record`, whose `record["wire.voltage"]` has `time` (n,) s and `values` (n,); of an
        instrument file its own kind of record.

    Raises:
        InputError: no such file, nothing readable in it, or arrays that do not fit each other.
    """
    if isinstance(source, _READ):
        return source
    if isinstance(source, Simulation):
        return _recorded(source, signals_of(source), "simulation")
    if is_frame(source):
        return record_from_frame(source)
    if isinstance(source, Mapping):
        return record_from_arrays(source)
    if isinstance(source, str | Path) and units is None and params is None:
        return open_record(source, namespace)
    if isinstance(source, str | Path):
        bench = bench_of(read_parameter_names(params), str(params)) if params else BenchHints()
        return record_of_table(source, bench, units or {})
    raise InputError(
        f"load: {type(source).__name__} given, expected a path, a mapping of arrays, a DataFrame, "
        "a simulation or a record"
    )


def load_parameters(source: Any = None) -> Parameters:
    """Parameters of a bench, each with its uncertainty (`parameters/`).

    Args:
        source: path of a ROS 2 parameter file; a mapping of names to values, flat
            (`{"wire.resistance": 2.8, "uncertainty.wire.resistance": 0.02}`) or nested; None for
            the table's defaults; parameters as they are. What is absent keeps its default.

    Raises:
        InputError: unreadable file, unknown name, wrong type or a value out of its range.
    """
    if isinstance(source, Parameters):
        return source
    if source is None:
        return Parameters.defaults()
    if isinstance(source, Mapping):
        return Parameters(*split_names(flatten(source)))
    if isinstance(source, str | Path):
        return read_parameters(source, ignore=node_groups())
    raise InputError(
        f"parameters: {type(source).__name__} given, expected a path, a mapping or Parameters"
    )


def simulate(
    drive: Any,
    parameters: Any = None,
    *,
    effects: Mapping[str, float] | None = None,
    rate: float = 100.0,
) -> Simulation:
    """The paper's model, and what effects are switched on, under given voltages (`physics/`).

    Args:
        drive: name of a protocol or path of its file; the mapping of such a file (`steps`);
            a pair of time (n,) s and voltage (n, w) V, one column a channel, each held to the next
            sample; or anything that `load` takes, whose measured voltages then drive the model.
        parameters: as for `load_parameters`; `bench.channels` says which rig it is.
        effects: size by name, `{"latent_heat": 12e3}`, beyond those in the parameters; other
            numbers of an effect by `name.number`.
        rate: samples a second of a protocol.

    Returns:
        `Simulation`: `time` (n,) s, `voltage`, `current`, `temperature`, `martensite_fraction`,
        `stress` (n, w), `deflection` (n,) m. `measure` makes a record of it.

    Raises:
        InputError: no such protocol or effect, wrong shapes, a voltage above the bench's limit in
            a protocol, or a record that lacks the voltage of a channel.
    """
    bench = load_parameters(parameters)
    for name, size in (effects or {}).items():
        bench = bench.replace(effect_values(name, float(size)), where="effects")
    if (protocol := _protocol(drive, bench)) is not None:
        if not 0.0 < rate <= 10_000.0:
            raise InputError(f"simulate: rate is {rate:g} Hz, expected 0 to 10000")
        return simulate_protocol(protocol, bench, 1.0 / rate)
    if isinstance(drive, tuple):
        if len(drive) != 2:
            raise InputError(f"simulate: {len(drive)} arrays given, expected time and voltage")
        return simulate_finely(bench, *drive)
    if isinstance(drive, str) and not Path(drive).exists():
        raise InputError(
            f"simulate: {drive}: neither a bag nor a protocol, expected one of "
            f"{', '.join(protocol_names())}"
        )
    (record,) = _bags([load(drive)])
    return simulate_finely(*drive_of(record, bench))


def measure(simulation: Simulation, seed: int = 1) -> Record:
    """A synthetic record: a simulation read through the simulator node's instruments.

    Args:
        simulation: of `simulate`.
        seed: of the noise; the same seed gives the same record.

    Raises:
        InputError: a seed below 0.
    """
    if seed < 0:
        raise InputError(f"measure: seed is {seed}, expected 0 or more")
    return _recorded(simulation, read_signals(signals_of(simulation), seed), "synthetic record")


def identify(
    records: Any, parameters: Any = None, experiments: Iterable[str] | None = None
) -> Identification:
    """Parameters with standard errors from what the records hold (`identify/`).

    Args:
        records: one of what `load` takes, or a list of them; they are combined.
        parameters: what is known beforehand (mass, area, ...), as for `load_parameters`.
        experiments: of E0 to E10; all that the records allow when None.

    Returns:
        `Identification`: `estimates` by name, each with `value`, `std`, `unit`; `parameters`, the
        given ones improved; `experiments`; `warnings`, to be read before the numbers are used.

    Raises:
        InputError: nothing to identify, or an experiment asked for that the records do not allow.
    """
    return _identify(_records(records), load_parameters(parameters), experiments)


def diagnose(
    records: Any,
    parameters: Any = None,
    hold_out: Any = (),
    *,
    signals: Sequence[str] = QUANTITIES,
) -> Diagnosis:
    """Where bench and model disagree, which effect causes it, how far it shrinks (`diagnose/`).

    Args:
        records: bags of one bench, one or a list of what `load` takes.
        parameters: as believed, `uncertainty.NAME` as priors; as for `load_parameters`.
        hold_out: further records of that bench, on which the shrinkage is measured; the last part
            of each record when empty.
        signals: which quantities are compared, of current, temperature, deflection.

    Returns:
        `Diagnosis`: `decision` (verdict, cause, candidates), `where`, `shrinkage`, `improved`
        parameters; `to_json()` is the result file of `sma-bench diagnose`.

    Raises:
        InputError: no record, an instrument's file, or nothing that can be compared.
    """
    unknown = sorted({signals} if isinstance(signals, str) else set(signals) - set(QUANTITIES))
    if unknown:
        raise InputError(f"diagnose: signals {unknown[0]!r}, expected some of {list(QUANTITIES)}")
    seen, unseen = (_bags(_records(given)) for given in (records, hold_out))
    return _diagnose(seen, load_parameters(parameters), unseen, quantities=signals)


def compare(records: Any, models: Any = ()) -> Overlay:
    """Records and models over each other: clocks aligned by the drive, differences in numbers.

    Args:
        records: one of what `load` takes, or a list of them, or a mapping of names to them; the
            first is what the others are compared with.
        models: parameters (as for `load_parameters`), a list or a mapping of names to them; each
            is simulated under the voltages of the first record.

    Returns:
        `Overlay`: `differences`, the largest first, and `plot()`; `print` shows a table.

    Raises:
        InputError: fewer than two in all, or nothing in common.
    """
    named = _named(records, "record")
    if not named:
        raise InputError("compare: no record, expected at least one")
    shown = dict(zip(named, _bags([load(given) for given in named.values()]), strict=True))
    first = next(iter(shown.values()))
    modelled = {}
    for name, given in _named(models, "model").items():
        simulation = simulate_finely(*drive_of(first, load_parameters(given)))
        modelled[name if name not in shown else f"{name} (model)"] = _recorded(
            simulation, signals_of(simulation), name
        )
    return overlay(shown | modelled, tuple(modelled))


def to_frame(thing: Any) -> Any:
    """A pandas DataFrame of a record or a result. Needs pandas.

    Args:
        thing: anything that `load` makes a `Record` of: a column a signal, index `time` in s,
            units in `attrs["units"]`, NaN where a signal has no sample (`load` takes it back);
            an identification: a row a parameter; a diagnosis: a row a candidate.

    Raises:
        InputError: pandas is not installed, or what is given has no such table.
    """
    if isinstance(thing, Identification):
        rows = {
            name: {"value": e.value, "std": e.std, "unit": e.unit, "n": e.n, "method": e.method,
                   "experiment": thing.origin(name)}
            for name, e in thing.estimates.items()
        }  # fmt: skip
        return _table(rows, "parameter")
    if isinstance(thing, Diagnosis):
        rows = {
            c["name"]: {k: c[k] for k in ("probability", "stage", "gap_over_noise", "log_evidence")}
            for c in thing.to_json()["candidates"]
        }
        return _table(rows, "candidate")
    (record,) = _bags([load(thing)])
    return frame_from_record(record)


def _table(rows: Mapping[str, Mapping[str, Any]], index: str) -> Any:
    frame = require_pandas().DataFrame.from_dict(rows, orient="index")
    frame.index.name = index
    return frame


def _recorded(simulation: Simulation, signals: Sequence[Signal], name: str) -> Record:
    return Record(Path(name), 0, {signal.name: signal for signal in signals})


def _named(given: Any, kind: str) -> dict[str, Any]:
    """Things by name: their own, that of their file, or a number."""
    if isinstance(given, Mapping) and not set(given) & set(BY_NAME) and all(
        isinstance(v, str | Path | Record | Parameters | Simulation) for v in given.values()
    ):
        return dict(given)
    found: dict[str, Any] = {}
    for k, thing in enumerate(given if isinstance(given, list | tuple) else [given], 1):
        path = thing if isinstance(thing, str | Path) else getattr(thing, "path", "")
        name = Path(path).name or f"{kind} {k}"
        found[name if name not in found else f"{name} ({k})"] = thing
    return found


def _records(given: Any) -> list[AnyRecord]:
    """Records of sources; of a workbook those of all its sheets."""
    records: list[AnyRecord] = []
    for source in given if isinstance(given, list | tuple) else [given]:
        is_path = isinstance(source, str | Path)
        records += open_records(source) if is_path else [load(source)]
    return records


def _bags(records: Sequence[AnyRecord]) -> list[Record]:
    for record in records:
        if not isinstance(record, Record):
            raise InputError(f"{record.path}: an instrument's file, expected a record of a bench")
    return [record for record in records if isinstance(record, Record)]


def _protocol(drive: Any, bench: Parameters) -> Protocol | None:
    named = isinstance(drive, str) and drive in protocol_names()
    if named or (isinstance(drive, str | Path) and Path(drive).suffix == ".yaml"):
        return load_protocol(drive, bench)
    if isinstance(drive, Mapping) and "steps" in drive:
        return parse_protocol(drive, bench)
    return None
