"""Runs a program on a case, in a process of its own that sees nothing but the records."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from examination.blind import case_files as files
from examination.blind.cases import QUANTITIES
from examination.blind.reality import happen
from examination.blind.rigs import BACK, COMMAND_PERIOD, FRONT, Stage, world_of
from examination.blind.sensors import measure
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.protocols import parse_protocol
from sma_bench.records.bag_writer import write_record

PACKAGE_ROOT = Path(__file__).resolve().parents[2]
RECORD, HOLD_OUT, NOMINAL, EXPERIMENT = "record", "hold_out", "nominal.yaml", "experiment"
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
_LOOK_EVERY = 0.02  # s
TIME_LIMIT = 120.0  # s


@dataclass(frozen=True)
class Examinee:
    """A program that takes the arguments of `sma-bench diagnose`; a case fails after `time_limit` s
    (plus half of that for each further record), or once it is `stopped`."""

    program: tuple[str, ...]
    time_limit: float = TIME_LIMIT
    stopped: threading.Event = field(default_factory=threading.Event)

    def ask(self, case: Path, place: Path, experiments: Sequence[Path] = (),
            nominal: Path | None = None) -> str:
        """Run the program on a case, with records of further experiments and parameters as stated
        by now, in a folder that contains only copies, and keep its answer in `place`. Returns why
        it failed, or "". Any fault of the program is a failed answer; OSError: it cannot start."""
        with tempfile.TemporaryDirectory(prefix="bench_") as folder:
            desk, begin, document, line = Path(folder), time.monotonic(), None, ""
            result, improved = desk / "result.json", desk / "improved.yaml"
            bags = {f"{EXPERIMENT}_{k}": bag for k, bag in enumerate(experiments, 1)}
            bags = {RECORD: case / RECORD, **bags, HOLD_OUT: case / HOLD_OUT}
            for name, bag in bags.items():
                shutil.copytree(bag, desk / name)
            shutil.copyfile(nominal or case / NOMINAL, desk / NOMINAL)
            try:
                self._run(desk, [name for name in bags if name != HOLD_OUT])
                if not result.is_file():
                    raise InputError("no result was written")
                found = json.loads(result.read_text(encoding="utf-8"))
                answer = files.checked_answer(found, "result")
                if improved.is_file():
                    read_parameters(improved)
                elif answer.verdict in ("effect", "recalibration"):
                    raise InputError(f"verdict {answer.verdict} without improved parameters")
                document = found
            except InputError as error:
                line = str(error).replace(f"{desk}/", "")
            except (ValueError, RecursionError) as error:
                line = f"result is not JSON: {str(error).splitlines()[0]}"
            if not self.stopped.is_set():
                text = improved.read_text() if document and improved.is_file() else None
                files.keep(place.parent, place.name, document, line, time.monotonic() - begin, text)
        return line

    def _run(self, desk: Path, records: Sequence[str]) -> None:
        """Run the program in its folder; raises InputError where it gives no answer."""
        command = [*self.program, *records, "--params", NOMINAL, "--hold-out", HOLD_OUT, "--json",
                   "result.json", "--out", "improved.yaml"]
        environment = dict(os.environ, PYTHONPATH=str(PACKAGE_ROOT), **_ONE_THREAD)
        limit = self.time_limit * (1 + len(records)) / 2.0  # half of it per record
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
            process = subprocess.Popen(command, cwd=desk, env=environment, text=True,
                                       start_new_session=True, stdin=subprocess.DEVNULL,
                                       stdout=subprocess.DEVNULL, stderr=errors)
            end = time.monotonic() + limit
            while process.poll() is None:
                if time.monotonic() > end or self.stopped.is_set():
                    with suppress(ProcessLookupError):  # its session: all that it started
                        os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
                    raise InputError(f"no answer within {limit:g} s")
                time.sleep(_LOOK_EVERY)
            errors.seek(0)
            lines = [text.strip() for text in errors if text.strip()]
        if process.returncode:
            last = lines[-1] if lines else "no message"
            raise InputError(f"exit code {process.returncode}: {last}"[:300])


# --- Run a program on every case of a set; existing answers are kept.
def open_cases(cases: Sequence[str], answers: Path) -> list[str]:
    return sorted(case for case in cases if not files.is_kept(answers, case))


def examine(examinee: Examinee, cases: Sequence[str], folder: Path, answers: Path,
            jobs: int = 1) -> int:
    """Run a program on `cases` below `folder`; returns how many failed."""
    place = folder.absolute()
    ask = {case: partial(examinee.ask, place / case, answers / case) for case in cases}
    return ask_all(examinee, ask, jobs)


def ask_all(examinee: Examinee, ask: Mapping[str, Callable[[], str]], jobs: int) -> int:
    """Do all calls of `ask`, `jobs` at a time; returns how many failed. An interrupt ends all."""
    failed = 0
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(call): name for name, call in ask.items()}
        try:
            for future in as_completed(running):
                if line := future.result():
                    failed += 1
                    print(f"failed: {running[future]}: {line}", file=sys.stderr)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            examinee.stopped.set()
            raise
    return failed


# --- Follow-up: perform the experiment that an answer suggests and ask again, at most three times.
#
# The suggested protocol is simulated on the case's own bench and recorded with the same instruments
# (and additional ones if the answer asks for them); then all records are diagnosed together. A test
# of the paper is not simulated: it gives the value of the hidden wire, off by a draw of the
# standard deviation that the answer states for the test.
LONGEST = 1000.0
_START_NS, _HOUR_NS = 1_750_000_000 * 10**9, 3600 * 10**9
_STREAM = 1_000_003  # of random numbers, apart from those of the cases


def follow_up(cases: files.CaseSet, labels: Mapping[str, Mapping[str, Any]], examinee: Examinee,
              answers: Path, jobs: int = 1, ties_only: bool = False) -> None:
    """Perform the experiments that answers suggest, all or only the ambiguous ones, and keep the
    answers afterwards in `answers`/after_1 to after_3; existing ones stay."""
    for number, name in enumerate(files.FOLLOW_UPS):
        ask = {}
        for case in cases.names:
            history, place = files.answers_of(answers, case), cases.folder.absolute() / case
            first, last = (history[k].answer if history else None for k in (0, -1))
            asked = last.next_experiment if last else None
            if ties_only and (first is None or first.verdict != "ambiguous"):
                continue
            if len(history) == number + 1 and asked and (asked.protocol or asked.parameters):
                given = place, answers / name / case, cases.seed, labels[case], history
                ask[case] = partial(_do_and_ask, *given, examinee)
        ask_all(examinee, ask, jobs)


def _do_and_ask(case: Path, place: Path, seed: int, label: Mapping[str, Any],
                history: Sequence[files.Kept], examinee: Examinee) -> str:
    """Perform the suggestions as the experiment node would, within the bench's limits."""
    with tempfile.TemporaryDirectory(prefix="bench_") as folder:
        bags: list[Path] = []
        try:
            stated = read_parameters(case / NOMINAL)
            for number, kept in enumerate(history):
                assert kept.answer is not None and kept.answer.next_experiment is not None
                key = (_STREAM, int(case.name), *([number] if number else []))
                random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
                asked = kept.answer.next_experiment
                if asked.parameters:
                    stated = after_tests(label, asked, stated, random)
                    continue
                bags.append(Path(folder) / f"{EXPERIMENT}_{number}")
                protocol = parse_protocol(dict(asked.protocol), stated, "next_experiment")
                if protocol.duration > LONGEST:
                    raise InputError(f"next_experiment: lasts {protocol.duration:g} s, expected "
                                     f"at most {LONGEST:g} s")
                # Recorded on the case's own bench, with the additional quantities.
                stage, (grid, voltage) = Stage.from_label(label), protocol.sample(COMMAND_PERIOD)
                world = world_of(stage.truth, label["features"])
                wanted = {*QUANTITIES[label["signals"]], *asked.quantities}
                shown = tuple(q for q in QUANTITIES["all"] if q in wanted)
                outcome = happen(world, grid, voltage)
                signals = measure(outcome, world, stage.sensors, random, shown)
                write_record(bags[-1], signals, "bench", _START_NS + number * _HOUR_NS)
        except InputError as error:
            files.keep(place.parent, place.name, None, str(error), 0.0)
            return str(error)
        nominal = Path(folder) / NOMINAL
        write_parameters(nominal, stated, names=sorted(stated.given))
        return examinee.ask(case, place, bags, nominal)


def after_tests(label: Mapping[str, Any], asked: files.NextExperiment, stated: Parameters,
                rng: np.random.Generator) -> Parameters:
    """Stated parameters after a test; raises InputError for one that no test measures."""
    stds, truth = asked.parameters, label["truth"]
    values, world = {}, world_of(Stage.from_label(label).truth, label["features"])
    for name, std in stds.items():
        if name not in truth:
            raise InputError(f"next_experiment: parameters: {name!r}, expected one of the wire's")
        # The true value in the hidden world, with the error of the instrument.
        hidden, kind = float(truth[name]), name.removeprefix("wire.stress_influence_")
        if kind != name:
            hidden /= max(world.feature(f"stress_influence_factor_{kind}"), 0.05)
        values[name] = float(hidden + std * rng.standard_normal())
        if name == FRONT:
            values[BACK] = values[name]
    return stated.replace(values, {name: stds.get(name, stds.get(FRONT, 0.0)) for name in values})
