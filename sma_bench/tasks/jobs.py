"""Identification, diagnosis and investigation for nodes, each run in a process of its own.

A task takes the node's own parameters (`settings`), the bench's, and a reporter; it returns JSON.
Whoever sets ROS parameters can reach only files below `record_root` (read) and `output_root`."""

import multiprocessing
import os
import re
import resource
import signal
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sma_bench.border import is_inside, make_folder, read_bytes
from sma_bench.errors import InputError
from sma_bench.lifeline import end_after
from sma_bench.parameters import Parameters
from sma_bench.progress import COMPILING, Report, part, silent
from sma_bench.results import json_text, write_result

Task = Callable[[Mapping[str, Any], Parameters, Report], str]

CANCELLED = "cancelled on request"
OWN_ROOT = "sma_bench_results"  # default output root
_OWN = re.compile(rb'\A\{(?s:.*)"parameters"|(?m:^)# (?:Improved by|Identified by|The model) ')
_LARGEST_RESULT = 1 << 26  # bytes
_DIAGNOSED = 0.9  # share of the time, about; the rest is for drawing the report
_SPAWN = multiprocessing.get_context("spawn")  # a fork inherits ROS's locks, not their threads
_LEAST_MEMORY = 4 << 30  # bytes of address space: compilers and threads reserve more than they use
_LONGEST = 3600  # s of CPU time; the longest diagnosis takes minutes


class Worker:
    """Runs one task at a time in a process; `end` kills it, from any thread."""

    def __init__(self, name: str) -> None:
        self._name, self._ended = name, ""
        self.process: Any = None

    def run(self, task: Task, settings: Mapping[str, Any], parameters: Parameters,
            report: Report = silent) -> str:
        """The task's result. Raises InputError: the task's own error, or why it was ended."""
        near, far = _SPAWN.Pipe(duplex=False)
        process = _SPAWN.Process(target=_work, args=(far, task, dict(settings), parameters))
        process.start()
        far.close()
        self.process, self._ended = process, ""
        try:
            while True:
                done, message = near.recv()
                if done is True:
                    return str(message)
                if done is False:
                    raise InputError(message)
                report(done, message)
        except (EOFError, OSError):  # it was killed, perhaps while sending
            process.join()
            status = process.exitcode or 0
            by = signal.Signals(-status).name if status < 0 else f"status {status}"
            why = self._ended or f"failed: its process ended with {by}"
            raise InputError(f"{self._name}: {why}") from None
        finally:
            self.process = None
            process.kill()  # the result is here: no need to wait for its interpreter to shut down
            process.join()
            near.close()

    def end(self, why: str = CANCELLED) -> bool:
        """End the running task, if any; returns whether there was one."""
        if (process := self.process) is None:
            return False
        self._ended = why
        process.kill()
        return True


def _work(pipe: Any, task: Task, settings: Mapping[str, Any], parameters: Parameters) -> None:
    """Runs in the process. Sends (share, step) of progress, (True, result) or (False, error)."""
    os.setsid()  # Ctrl-C in a terminal reaches the node only, which then ends this process
    node = multiprocessing.parent_process()
    assert node is not None and node.pid is not None
    end_after(node.pid, signal.SIGKILL)
    # The parent may run with real-time priority; this work must not.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, 0, max(os.getpriority(os.PRIO_PROCESS, 0), 0))
    memory = max(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"), _LEAST_MEMORY)
    for kind, most in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, _LONGEST)):
        _, hard = resource.getrlimit(kind)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(kind, (most, most))

    def report(share: float, what: str = "") -> None:
        pipe.send((float(share), what))

    from sma_bench.compiled import when_compiling  # imports numba, which the node itself avoids

    when_compiling(lambda: report(0.0, COMPILING))
    try:
        pipe.send((True, task(settings, parameters, report)))
    except InputError as error:
        pipe.send((False, str(error)))
    except Exception as error:
        traceback.print_exc()
        reason = " ".join(str(error).split())
        pipe.send((False, f"failed: {type(error).__name__}: {reason}"))


def records_inside(settings: Mapping[str, Any], parameter: str = "record",
                   required: bool = False) -> list[str]:
    """Paths of the records in a list parameter, relative ones below `record_root`. InputError: a
    record, or a link in a bag, leads outside the root; the list is empty though `required`."""
    # ROS cannot type an empty array: [""] stands for none.
    names, root = [name for name in settings[parameter] if name], settings["record_root"]
    if required and not names:
        raise InputError(f"{parameter}: is empty, expected the path of at least one record")
    return [str(_inside(root, name, parameter, "record_root")) for name in names]


def output_inside(settings: Mapping[str, Any], parameter: str, suffix: str = "") -> str:
    """The path in a parameter, below `output_root` (OWN_ROOT if that is empty); "" stays "".
    InputError: it leads outside, is hidden, lacks the suffix, or is a foreign file."""
    if not (path := settings[parameter]):
        return ""
    hidden = [part for part in Path(path).parts if part.startswith(".") and part.strip(".")]
    if hidden:
        raise InputError(f"{parameter}: {path}: {hidden[0]} is hidden, expected plain names")
    if suffix and not path.endswith(suffix):
        raise InputError(f"{parameter}: {path}, expected a name that ends in {suffix}")
    found = _inside(settings["output_root"] or OWN_ROOT, path, parameter, "output_root")
    if suffix:
        require_own(found, parameter=parameter)
    return str(found)


def require_own(*files: Path, parameter: str) -> None:
    """Raises InputError: one of the files exists and was not written by sma-bench."""
    for file in files:
        if file.exists() and not _OWN.search(read_bytes(file, _LARGEST_RESULT)):
            raise InputError(f"{parameter}: {file} is not a file that sma-bench has written")


def _inside(root: str, path: str, parameter: str, root_parameter: str) -> Path:
    top, found = Path(root or "."), Path(root, path)
    try:
        # A bag from elsewhere may contain a link to any file of this computer.
        parts = [found, *(found.iterdir() if found.is_dir() else ())]
        outside = not all(is_inside(part, top) for part in parts)
    except OSError as error:  # no permission, too long a name
        raise InputError(f"{parameter}: {found}: cannot be read: {error.strerror}") from None
    if outside:
        where = root or f"{top.resolve()} (where the node was started)"
        if root in ("", OWN_ROOT):
            where += f"; {root_parameter} names another"
        raise InputError(f"{parameter}: {found} lies outside {root_parameter} {where}")
    return found


def identify(settings: Mapping[str, Any], parameters: Parameters, report: Report) -> str:
    """Identify from `record`; `identified.yaml` and `identified.json` go to `output_directory`."""
    records = records_inside(settings, required=True)
    output = output_inside(settings, "output_directory")
    from sma_bench.tasks.work import identify_files, write_identified

    experiments = [name for name in settings["experiments"] if name] or None
    result = identify_files(records, parameters, experiments, report=report)
    folder = make_folder(Path(output))
    files = folder / "identified.yaml", folder / "identified.json"
    require_own(*files, parameter="output_directory")
    write_identified(files[0], result, "the identification node", records)
    write_result(files[1], result.to_json())
    return json_text(result.to_json())


def diagnose(settings: Mapping[str, Any], parameters: Parameters, report: Report) -> str:
    """Diagnose `record`, `hold_out` aside; write `improved` and `report` where they are set."""
    records = records_inside(settings, required=True)
    hold_out = records_inside(settings, "hold_out")
    improved = output_inside(settings, "improved", ".yaml")
    page = output_inside(settings, "report")
    from sma_bench.tasks.work import diagnose_files, write_improved

    share = _DIAGNOSED if page else 1.0
    result = diagnose_files(records, hold_out, parameters, report=part(report, 0.0, share))
    if improved:
        make_folder(Path(improved).parent)
        write_improved(improved, result, "the diagnosis node")
    if page:
        from sma_bench.report.page import Made
        from sma_bench.report.reports import write_diagnosis_report

        made = Made("the diagnosis node", [*records, *hold_out])
        write_diagnosis_report(page, result, part(report, share, 1.0), made)
    return json_text(result.to_json())


def investigation_folder(settings: Mapping[str, Any]) -> str:
    """The folder of an investigation. InputError: it, or a record, lies outside the roots."""
    records_inside(settings)
    if not (folder := output_inside(settings, "folder")):
        raise InputError("folder: is empty, expected the folder of the investigation")
    return folder


def investigate(settings: Mapping[str, Any], parameters: Parameters, report: Report) -> str:
    """Begin or continue in the folder and diagnose new records. Returns the history as JSON, with
    `outcome` (a line, "" before the first record) and `next` (of `next_run`, null for none)."""
    from sma_bench.tasks.investigation import OPEN, QUANTITIES, Investigation

    signals = [name for name in settings["signals"] if name]
    case = Investigation(investigation_folder(settings), settings["budget"], signals or QUANTITIES)
    records_inside({**settings, "record": case.given})  # paths from its file, too
    case.begin(parameters, records_inside(settings))
    if case.pending:
        case.diagnose(report)
    if case.chapters:
        case.write_page("the investigation node")
    following = case.next_run() if case.state == OPEN else None
    outcome = case.outcome if case.chapters else ""
    return json_text({**case.to_json(), "outcome": outcome, "next": following})
