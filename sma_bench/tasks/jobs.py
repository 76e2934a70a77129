"""Identification and diagnosis as processes of their own, so that they cannot block a node."""

import json
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sma_bench.border import is_inside, read_bytes
from sma_bench.errors import InputError
from sma_bench.lifeline import end_with_parent, tied_to_this_process
from sma_bench.parameters import Parameters
from sma_bench.progress import COMPILING, Report, part, silent
from sma_bench.results import json_text, write_result

CANCELLED = "cancelled on request"
OWN_ROOT = "sma_bench_results"
_OWN_BEGINNINGS = (
    b"# Improved by ", b"# Identified by ", b"# The model ", b'{\n  "parameters"',
)
_LARGEST_RESULT = 1 << 26
_BAD_INPUT = 2
_REPORTED = re.compile(r"progress (?P<share>[01]\.\d+) (?P<what>.*)")  # as `tell` prints it
_DIAGNOSED = 0.9  # of the time, about; the rest draws the report
_BUSY = re.compile(r"busy: (?P<percent>\d+) %, (?P<what>.*)")


class JobProcess:
    """Runs one job at a time in a Python process; `kill` may come from any thread."""

    def __init__(self, work: str) -> None:
        """`work` is what the jobs are called in messages."""
        self._work = work
        self._running: subprocess.Popen[str] | None = None
        self._killed = self._cancelled = False

    def run(self, job: "Job", report: Report = silent) -> str:
        """The job's result, waited for without using the processor.

        Args:
            report: called with what the job reports meanwhile.

        Raises:
            InputError: what the job raised, or that it was ended.
        """
        process = self._running = subprocess.Popen(
            [sys.executable, "-m", "sma_bench.tasks.jobs", type(job).__name__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            # Ctrl-C in a terminal is for the node, which then ends this process.
            start_new_session=True, env=tied_to_this_process(),
        )
        if self._killed:
            process.kill()
        errors: list[str] = []
        assert process.stdin and process.stdout and process.stderr
        with ThreadPoolExecutor(1) as beside:  # a pipe that nobody reads would stop the process
            output = beside.submit(process.stdout.read)
            with suppress(BrokenPipeError), process.stdin:  # it has ended; its status says why
                process.stdin.write(json.dumps(asdict(job)))
            for line in process.stderr:
                if said := _REPORTED.match(line):
                    report(float(said["share"]), said["what"])
                else:
                    errors.append(line)
        status = process.wait()
        self._running = None
        cancelled, self._cancelled = self._cancelled, False
        if status == 0:
            return output.result()
        if status == _BAD_INPUT:
            raise InputError(output.result().strip())
        if self._killed or cancelled:
            why = "ended with its node" if self._killed else CANCELLED
            raise InputError(f"{self._work}: {why}")
        last = [line.strip() for line in errors if line.strip()][-1:] or [f"status {status}"]
        raise InputError(f"{self._work}: failed: {last[0]}")

    def cancel(self) -> bool:
        """End the running job, and no later one; whether there was one."""
        running = self._running
        if running is None:
            return False
        self._cancelled = True
        running.kill()
        return True

    def kill(self) -> None:
        """End the running job, and every later one."""
        self._killed = True
        running = self._running
        if running is not None:
            running.kill()


def tell(share: float, what: str = "") -> None:
    """Said by a job to whoever waits for it: the share that is done, and what comes now."""
    print(f"progress {share:.3f} {what}", file=sys.stderr, flush=True)


def busy(share: float, what: str) -> str:
    """The state of a node whose job is so far."""
    return f"busy: {100.0 * share:.0f} %, {what}"


def told_share(state: str) -> tuple[float, str] | None:
    """What `busy` put into a state; None of another one."""
    found = _BUSY.match(state)
    return (int(found["percent"]) / 100.0, found["what"]) if found else None


def records_inside(root: str, records: list[str], parameter: str = "record") -> list[str]:
    """Paths of `records`, relative ones below `root`; none may lie outside.

    Raises:
        InputError: no records, or one outside the root, `..` and links followed, those in the
            folder of a bag too.
    """
    if not records:
        raise InputError(f"{parameter}: is empty, expected the path of one record or more")
    return [str(_inside(root, record, parameter, "record_root")) for record in records]


def output_inside(root: str, path: str, parameter: str, suffix: str = "") -> str:
    """The path of what is to be written, a relative one below `root`; "" stays "".

    Without a root results have a folder of their own, where nothing else can be replaced.

    Raises:
        InputError: it lies outside the root, `..` and links followed, has a hidden name in it, or
            not the suffix.
    """
    if not path:
        return ""
    hidden = [part for part in Path(path).parts if part.startswith(".") and part.strip(".")]
    if hidden:
        raise InputError(f"{parameter}: {path}: {hidden[0]} is hidden, expected plain names")
    if suffix and not path.endswith(suffix):
        raise InputError(f"{parameter}: {path}, expected a name that ends in {suffix}")
    found = _inside(root or OWN_ROOT, path, parameter, "output_root")
    if suffix:
        require_own(found, parameter=parameter)
    return str(found)


def require_own(*files: Path, parameter: str) -> None:
    """InputError where one of the files exists and is none of those that jobs write."""
    for file in files:
        if file.exists() and not read_bytes(file, _LARGEST_RESULT).startswith(_OWN_BEGINNINGS):
            raise InputError(f"{parameter}: {file} is not a file that sma-bench has written")


def _inside(root: str, path: str, parameter: str, root_parameter: str) -> Path:
    top = Path(root or ".")
    found = Path(root, path)
    try:
        # A bag from elsewhere may hold a link to any file of this computer.
        parts = [found, *(found.iterdir() if found.is_dir() else ())]
        outside = not all(is_inside(part, top) for part in parts)
    except (OSError, ValueError):  # no permission, a zero byte
        outside = True
    if outside:
        where = root or f"{top.resolve()} (where the node was started)"
        if root in ("", OWN_ROOT):
            where += f"; {root_parameter} names another"
        raise InputError(f"{parameter}: {found} lies outside {root_parameter} {where}")
    return found


def given(names: Sequence[str]) -> list[str]:
    """Names of a list parameter; ROS cannot type an empty array: [""] stands for none."""
    return [name for name in names if name]


def made_folder(path: str) -> Path:
    """The folder, made if it does not exist.

    Raises:
        InputError: it cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    return folder


# --- The kinds of job.

PARAMETER_FILE = "identified.yaml"
RESULT_FILE = "identified.json"


@dataclass(frozen=True)
class IdentificationJob:
    """What to identify from, and where the result goes; plain values that travel as JSON."""

    records: list[str]
    experiments: list[str]
    output_directory: str
    values: dict[str, Any]
    uncertainty: dict[str, float]

    @classmethod
    def from_settings(
        cls, settings: Mapping[str, Any], parameters: Parameters
    ) -> "IdentificationJob":
        """Snapshot of the identification node's parameters.

        Raises:
            InputError: no record, one outside `record_root`, or a result outside `output_root`.
        """
        return cls(
            records=records_inside(settings["record_root"], given(settings["record"])),
            experiments=given(settings["experiments"]),
            output_directory=output_inside(
                settings["output_root"], settings["output_directory"], "output_directory"
            ),
            values={name: parameters[name] for name in parameters.given},
            uncertainty=parameters.given_uncertainty,
        )

    def run(self) -> str:
        """Identify, write `identified.yaml` and `identified.json`, and return the latter's text.

        Raises:
            InputError: a record, an experiment or the output folder is not as it should be.
        """
        from sma_bench.tasks.work import identify_files, write_identified

        parameters = Parameters(self.values, self.uncertainty)
        result = identify_files(self.records, parameters, self.experiments or None, report=tell)
        folder = made_folder(self.output_directory)
        files = folder / PARAMETER_FILE, folder / RESULT_FILE
        require_own(*files, parameter="output_directory")
        write_identified(files[0], result, "the identification node", self.records)
        write_result(files[1], result.to_json())
        return json_text(result.to_json())


@dataclass(frozen=True)
class DiagnosisJob:
    """What to diagnose, and where files go; plain values that travel as JSON."""

    records: list[str]
    hold_out: list[str]
    improved: str
    report: str
    values: dict[str, Any]
    uncertainty: dict[str, float]

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any], parameters: Parameters) -> "DiagnosisJob":
        """Snapshot of the diagnosis node's parameters.

        Raises:
            InputError: no record, one outside `record_root`, or a result outside `output_root`.
        """
        root, held_out = settings["record_root"], given(settings["hold_out"])
        output, improved = settings["output_root"], settings["improved"]
        return cls(
            records=records_inside(root, given(settings["record"])),
            hold_out=records_inside(root, held_out, "hold_out") if held_out else [],
            improved=output_inside(output, improved, "improved", ".yaml"),
            report=output_inside(output, settings["report"], "report"),
            values={name: parameters[name] for name in parameters.given},
            uncertainty=parameters.given_uncertainty,
        )

    def run(self) -> str:
        """Diagnose, write the files asked for, and return the contract's JSON.

        Raises:
            InputError: a record or a path is not as it should be.
        """
        from sma_bench.tasks.work import diagnose_files, write_improved

        parameters = Parameters(self.values, self.uncertainty)
        share = _DIAGNOSED if self.report else 1.0
        result = diagnose_files(
            self.records, self.hold_out, parameters, report=part(tell, 0.0, share)
        )
        if self.improved:
            made_folder(str(Path(self.improved).parent))
            write_improved(self.improved, result, "the diagnosis node")
        if self.report:
            from sma_bench.report.diagnosis_report import write_diagnosis_report
            from sma_bench.report.page import Made

            made = Made("the diagnosis node", [*self.records, *self.hold_out])
            write_diagnosis_report(self.report, result, part(tell, share, 1.0), made)
        return json_text(result.to_json())


@dataclass(frozen=True)
class InvestigationJob:
    """An investigation's next diagnosis; plain values that travel as JSON."""

    folder: str
    records: list[str]
    budget: float
    signals: list[str]
    values: dict[str, Any]
    uncertainty: dict[str, float]

    @classmethod
    def from_settings(
        cls, settings: Mapping[str, Any], parameters: Parameters
    ) -> "InvestigationJob":
        """Snapshot of the investigation node's parameters.

        Raises:
            InputError: no folder, one outside `output_root`, or a record outside `record_root`.
        """
        folder = output_inside(settings["output_root"], settings["folder"], "folder")
        if not folder:
            raise InputError("folder: is empty, expected where the investigation is kept")
        records = given(settings["record"])
        return cls(
            folder=folder,
            records=records_inside(settings["record_root"], records) if records else [],
            budget=settings["budget"],
            signals=given(settings["signals"]),
            values={name: parameters[name] for name in parameters.given},
            uncertainty=parameters.given_uncertainty,
        )

    def run(self) -> str:
        """Begin or go on in the folder and diagnose what is new.

        Returns:
            The story as JSON, with `outcome` (a line, "" where there is no record yet) and `next`
            (`NextRun.to_json`, null where nothing is to be run).

        Raises:
            InputError: the folder, a record or the proposed protocol is not as it should be.
        """
        from sma_bench.tasks.investigation import OPEN, QUANTITIES, Investigation

        case = Investigation(self.folder, self.budget, self.signals or QUANTITIES)
        case.begin(Parameters(self.values, self.uncertainty), self.records)
        if case.pending:
            case.diagnose(tell)
        if case.chapters:
            case.write_page("the investigation node")
        following = case.next_run().to_json() if case.state == OPEN else None
        outcome = case.outcome if case.chapters else ""
        return json_text({**case.to_json(), "outcome": outcome, "next": following})


Job = IdentificationJob | DiagnosisJob | InvestigationJob
JOBS: dict[str, type[Job]] = {
    "IdentificationJob": IdentificationJob, "DiagnosisJob": DiagnosisJob,
    "InvestigationJob": InvestigationJob,
}


def run_job(kind: str) -> int:
    """The program: a job as JSON on standard input, its result on standard output."""
    from sma_bench.compiled import when_compiling  # brings numba, which the node does without

    end_with_parent()
    when_compiling(lambda: tell(0.0, COMPILING))
    try:
        print(JOBS[kind](**json.load(sys.stdin)).run(), end="")
    except InputError as error:
        print(error)
        return _BAD_INPUT
    return 0


if __name__ == "__main__":
    raise SystemExit(run_job(sys.argv[1]))
