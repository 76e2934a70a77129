"""The experiment that an ambiguous answer asks for, performed, and the diagnosis asked again.

The lab runs the suggested protocol on the case's own bench, records it with the same instruments,
and hands the second record over together with the first.
"""

import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.blind.case_set import CaseSet
from sma_bench.blind.deck import QUANTITIES
from sma_bench.blind.drives import COMMAND_PERIOD
from sma_bench.blind.examination import Report, ask_all, open_cases
from sma_bench.blind.examinee import EXPERIMENT, NOMINAL, Examinee, Given
from sma_bench.blind.kept import SECOND, Kept
from sma_bench.blind.reality import World, happen
from sma_bench.blind.rigs import CHANNELS, rig_of
from sma_bench.blind.sensors import Sensors, measure
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import Protocol, parse_protocol
from sma_bench.records.write import write_record

LONGEST = 900.0
_START_NS = 1_750_000_000 * 10**9
# Apart from the streams that the cases are made of.
_STREAM = 1_000_003


def asks_for_more(kept: Kept) -> bool:
    """An ambiguous answer with a protocol."""
    answer = kept.answer
    if answer is None or answer.verdict != "ambiguous" or answer.next_experiment is None:
        return False
    return bool(answer.next_experiment.protocol)


def follow_up(
    cases: CaseSet,
    labels: Mapping[str, Mapping[str, Any]],
    kept: Sequence[Kept],
    examinee: Examinee,
    answers: Path,
    jobs: int = 1,
    report: Report = lambda done, line: None,
) -> None:
    """Perform what is asked for and keep each second answer in `answers`/second.

    Args:
        cases: the set; labels: by case, for the world.
        kept: the first answers.
        examinee: who gave them.
        answers: folder of the examinee; second answers that are there stay.
        report: told after each case.
    """
    asking = {k.case: k for k in kept if asks_for_more(k)}
    waiting = open_cases(list(asking), answers / SECOND)
    ask = {
        name: partial(_perform_and_ask, cases, labels[name], asking[name], examinee)
        for name in waiting
    }
    ask_all(examinee, ask, answers / SECOND, jobs, report)


def _perform_and_ask(
    cases: CaseSet, label: Mapping[str, Any], kept: Kept, examinee: Examinee
) -> Given:
    assert kept.answer is not None and kept.answer.next_experiment is not None
    case = cases.folder / kept.case
    try:
        nominal = read_parameters(case / NOMINAL)
        protocol = bench_protocol(kept.answer.next_experiment.protocol, nominal)
    except InputError as error:
        return Given(None, str(error), 0.0)
    seed = np.random.SeedSequence(cases.seed, spawn_key=(_STREAM, int(kept.case)))
    with tempfile.TemporaryDirectory(prefix="bench_") as folder:
        bag = Path(folder) / EXPERIMENT
        perform(label, protocol, bag, np.random.default_rng(seed))
        return examinee.ask(case, bag)


def bench_protocol(document: Mapping[str, Any], nominal: Parameters) -> Protocol:
    """The suggested protocol as the experiment node would run it.

    Raises:
        InputError: no protocol, beyond the bench's limits, or too long.
    """
    protocol = parse_protocol(dict(document), nominal, "next_experiment")
    if protocol.duration > LONGEST:
        raise InputError(
            f"next_experiment: lasts {protocol.duration:g} s, expected at most {LONGEST:g} s"
        )
    return protocol


def perform(
    label: Mapping[str, Any], protocol: Protocol, bag: Path, rng: np.random.Generator
) -> None:
    """Run a protocol on a case's bench and record it.

    Args:
        label: sealed label of the case.
        protocol: for the channels of its rig.
        bag: new folder.
        rng: noise and jitter.
    """
    time, voltage = protocol.sample(COMMAND_PERIOD)
    world = World(rig_of(label["truth"]), label["features"])
    sensors = Sensors.from_json(label["sensors"])
    outcome = happen(world, time, voltage)
    quantities = QUANTITIES[label["signals"]]
    write_record(bag, measure(outcome, world, sensors, CHANNELS, rng, quantities), "bench",
                 "mcap", _START_NS)  # fmt: skip
