"""One case put to one program: a process of its own that sees the records and nothing else."""

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
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from examination.blind.case_files import (
    FOLLOW_UPS,
    CaseSet,
    Kept,
    NextExperiment,
    answers_of,
    checked_answer,
    is_kept,
    keep,
)
from examination.blind.cases import QUANTITIES
from examination.blind.reality import happen
from examination.blind.rigs import BACK, COMMAND_PERIOD, FRONT, Stage, world_of
from examination.blind.sensors import measure
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.protocols import Protocol, parse_protocol
from sma_bench.records.bag_writer import write_record

PACKAGE_ROOT = Path(__file__).resolve().parents[2]
RECORD, HOLD_OUT, NOMINAL, EXPERIMENT = "record", "hold_out", "nominal.yaml", "experiment"
_RESULT, _IMPROVED = "result.json", "improved.yaml"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_NEEDS_IMPROVED = ("effect", "recalibration")
_LONGEST_LINE = 300


@dataclass(frozen=True)
class Given:
    """What came back: the plain result (None: failed, `line` says why), and the text of the
    improved parameter file."""

    result: Any
    line: str
    seconds: float
    improved: str | None = None


class Examinee:
    """A program that takes the arguments of `sma-bench diagnose`; a case fails after `time_limit` s
    (half as long more a further record)."""

    def __init__(self, program: Sequence[str], time_limit: float) -> None:
        self._program = tuple(program)
        self._limit = time_limit
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._stopped = False

    def stop(self) -> None:
        """End what runs, and start nothing more."""
        with self._lock:
            self._stopped = True
            for process in self._running:
                if process.poll() is None:
                    _kill(process)

    def ask(
        self, case: Path, experiments: Sequence[Path] = (), nominal: Path | None = None
    ) -> Given:
        """Put a case, the records of further experiments and what the owners believe by now to the
        program, in a folder of its own that holds copies and nothing else. Whatever the program
        does is a failed answer; one that cannot be started raises OSError."""
        with tempfile.TemporaryDirectory(prefix="bench_") as folder:
            desk, records = Path(folder), [RECORD]
            for name in (RECORD, HOLD_OUT):
                _copy(case / name, desk / name)
            _copy(nominal or case / NOMINAL, desk / NOMINAL)
            for number, bag in enumerate(experiments, 1):
                records.append(f"{EXPERIMENT}_{number}")
                _copy(bag, desk / records[-1])
            begin = time.monotonic()
            try:
                self._run(desk, records)
                if not (desk / _RESULT).is_file():
                    raise InputError("no result was written")
                result = json.loads((desk / _RESULT).read_text(encoding="utf-8"))
                answer, improved = checked_answer(result, "result"), None
                if (desk / _IMPROVED).is_file():
                    read_parameters(desk / _IMPROVED)
                    improved = (desk / _IMPROVED).read_text(encoding="utf-8")
                elif answer.verdict in _NEEDS_IMPROVED:
                    raise InputError(f"verdict {answer.verdict} without improved parameters")
                return Given(result, "", time.monotonic() - begin, improved)
            except InputError as error:
                line = str(error).replace(f"{desk}/", "")
            except (ValueError, RecursionError) as error:
                line = f"result is not JSON: {str(error).splitlines()[0]}"
            return Given(None, line, time.monotonic() - begin)

    def _run(self, desk: Path, records: Sequence[str]) -> None:
        """Run the program in its folder; raises InputError where it gives no answer."""
        command = [
            *self._program, *records, "--params", NOMINAL, "--hold-out", HOLD_OUT,
            "--json", _RESULT, "--out", _IMPROVED,
        ]  # fmt: skip
        # The caller's environment, with one thread a process and without a trace of its folder.
        paths = [str(PACKAGE_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {k: v for k, v in os.environ.items() if k not in ("OLDPWD", "_")}
        environment |= dict.fromkeys(_ONE_THREAD, "1")
        environment |= {"PWD": str(desk), "PYTHONPATH": os.pathsep.join(paths)}
        limit = self._limit * (1 + len(records)) / 2.0  # half of the time goes with the records
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
            with self._lock:
                if self._stopped:
                    raise InputError("the examination was stopped")
                process = subprocess.Popen(
                    command, cwd=desk, env=environment, text=True, start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors,
                )  # fmt: skip
                self._running.add(process)
            try:
                code = process.wait(timeout=limit)
            except subprocess.TimeoutExpired:
                _kill(process)
                process.wait()
                raise InputError(f"no answer within {limit:g} s") from None
            finally:
                with self._lock:
                    self._running.discard(process)
            errors.seek(0)
            said = [text.strip() for text in errors if text.strip()]
        if code:
            said = said or ["nothing said"]
            raise InputError(f"exit code {code}: {said[-1]}"[:_LONGEST_LINE])


def _copy(source: Path, target: Path) -> None:
    """Contents only: links and times of files would show where the case lies and when it was
    made."""
    if source.is_dir():
        shutil.copytree(source, target, copy_function=shutil.copyfile)
        os.utime(target)
    else:
        shutil.copyfile(source, target)


def _kill(process: subprocess.Popen[str]) -> None:
    """End a process and all that it started: it leads a session of its own."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


# --- Every case of a set put to one program; what is answered stays answered.


def open_cases(cases: Sequence[str], answers: Path) -> list[str]:
    """Those of the cases that have no answer in the examinee's folder yet."""
    return sorted(case for case in cases if not is_kept(answers, case))


def examine(
    examinee: Examinee, cases: Sequence[str], folder: Path, answers: Path, jobs: int = 1
) -> int:
    """Put `cases` below `folder` to a program; how many failed."""
    ask = {case: partial(examinee.ask, folder.absolute() / case) for case in cases}
    return ask_all(examinee, ask, answers, jobs)


def ask_all(
    examinee: Examinee, ask: Mapping[str, Callable[[], Given]], answers: Path, jobs: int
) -> int:
    """Do every call of `ask`, `jobs` at a time, and keep what it gives under its name in `answers`
    as soon as it is there; how many failed. Interrupted, it ends what runs and leaves it open."""
    failed = 0
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(call): name for name, call in ask.items()}
        try:
            for future in as_completed(running):
                name, given = running[future], future.result()
                keep(answers, name, given.result, given.line, given.seconds, given.improved)
                if given.line:
                    failed += 1
                    print(f"failed: {name}: {given.line}", file=sys.stderr)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            examinee.stop()
            raise
    return failed


# --- What an answer asks for, done, and the diagnosis asked again: at most three times.
#
# The lab runs the suggested protocol on the case's own bench, records it with the same instruments
# (and with one more where that is what was asked for), and hands all records over together. A test
# of the paper is not played: its instrument reads what the hidden wire has, off by a draw of the
# standard deviation that the answer has stated for it.

LONGEST = 1000.0
_START_NS = 1_750_000_000 * 10**9
_HOUR_NS = 3600 * 10**9
# Apart from the streams that the cases are made of.
_STREAM = 1_000_003


def asks_for_more(kept: Kept) -> bool:
    """An answer with an experiment, whatever its verdict."""
    asked = kept.answer.next_experiment if kept.answer else None
    return asked is not None and bool(asked.protocol or asked.parameters)


def follow_up(
    cases: CaseSet, labels: Mapping[str, Mapping[str, Any]], examinee: Examinee, answers: Path,
    jobs: int = 1,
) -> None:
    """Do what the examinee's answers ask for, and keep each one after it in `answers`/after_1 to
    after_3; what has been answered stays."""
    for number, name in enumerate(FOLLOW_UPS):
        ask = {}
        for case in cases.names:
            history, place = answers_of(answers, case), cases.folder.absolute() / case
            if len(history) == number + 1 and asks_for_more(history[-1]):
                ask[case] = partial(
                    _do_and_ask, place, cases.seed, labels[case], history, examinee
                )
        ask_all(examinee, ask, answers / name, jobs)


def _do_and_ask(
    case: Path, seed: int, label: Mapping[str, Any], history: Sequence[Kept], examinee: Examinee
) -> Given:
    with tempfile.TemporaryDirectory(prefix="bench_") as folder:
        bags: list[Path] = []
        try:
            believed = read_parameters(case / NOMINAL)
            for number, kept in enumerate(history):
                assert kept.answer is not None and kept.answer.next_experiment is not None
                key = (_STREAM, int(case.name), *([number] if number else []))
                random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
                asked = kept.answer.next_experiment
                if asked.parameters:
                    believed = after_tests(label, asked, believed, random)
                    continue
                bags.append(Path(folder) / f"{EXPERIMENT}_{number}")
                protocol = bench_protocol(asked.protocol, believed)
                # Recorded on the case's own bench, with quantities that are measured more.
                stage, (grid, voltage) = Stage.from_label(label), protocol.sample(COMMAND_PERIOD)
                world = world_of(stage.truth, label["features"])
                wanted = {*QUANTITIES[label["signals"]], *asked.quantities}
                signals = measure(
                    happen(world, grid, voltage), world, stage.sensors, protocol.channels, random,
                    tuple(q for q in QUANTITIES["all"] if q in wanted),
                )
                write_record(bags[-1], signals, "bench", _START_NS + number * _HOUR_NS)
        except InputError as error:
            return Given(None, str(error), 0.0)
        nominal = Path(folder) / NOMINAL
        write_parameters(nominal, believed, names=sorted(believed.given))
        return examinee.ask(case, bags, nominal)


def after_tests(
    label: Mapping[str, Any], asked: NextExperiment, believed: Parameters,
    rng: np.random.Generator,
) -> Parameters:
    """What is believed after a test of some parameters; raises InputError for one that no test
    gives."""
    stds, truth = asked.parameters, label["truth"]
    values, world = {}, world_of(Stage.from_label(label).truth, label["features"])
    for name, std in stds.items():
        if name not in truth:
            raise InputError(f"next_experiment: parameters: {name!r}, expected one of the wire's")
        # What an instrument finds in the hidden wire, with what its world does to it.
        hidden, kind = float(truth[name]), name.removeprefix("wire.stress_influence_")
        if kind != name:
            hidden /= max(world.feature(f"stress_influence_factor_{kind}"), 0.05)
        values[name] = float(hidden + std * rng.standard_normal())
        if name == FRONT:
            values[BACK] = values[name]
    return believed.replace(values, {name: stds.get(name, stds.get(FRONT, 0.0)) for name in values})


def bench_protocol(document: Mapping[str, Any], nominal: Parameters) -> Protocol:
    """The suggested protocol as the experiment node would run it; raises InputError for one beyond
    the bench's limits, or too long."""
    protocol = parse_protocol(dict(document), nominal, "next_experiment")
    if protocol.duration > LONGEST:
        raise InputError(
            f"next_experiment: lasts {protocol.duration:g} s, expected at most {LONGEST:g} s"
        )
    return protocol
