"""One identification as a process of its own, so that a fit cannot block a node. No ROS."""

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sma_bench.commands.output import write_json
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters

PARAMETER_FILE = "identified.yaml"
RESULT_FILE = "identified.json"
_BAD_INPUT = 2


@dataclass(frozen=True)
class Job:
    """What to identify from, and where the result goes; plain values that travel as JSON."""

    records: list[str]
    experiments: list[str]
    output_directory: str
    values: dict[str, Any]
    uncertainty: dict[str, float]

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any], parameters: Parameters) -> "Job":
        """Snapshot of the identification node's parameters.

        Raises:
            InputError: no record, or one outside `record_root`.
        """
        return cls(
            records=records_inside(settings["record_root"], _given(settings["record"])),
            experiments=_given(settings["experiments"]),
            output_directory=settings["output_directory"],
            values={name: parameters[name] for name in parameters.given},
            uncertainty=parameters.given_uncertainty,
        )

    def run(self) -> str:
        """Identify, write `identified.yaml` and `identified.json`, and return the latter's text.

        Raises:
            InputError: a record, an experiment or the output folder is not as it should be.
        """
        from sma_bench.identify import identify
        from sma_bench.records import open_record

        records = [open_record(path) for path in self.records]
        parameters = Parameters(self.values, self.uncertainty)
        result = identify(records, parameters, self.experiments or None)
        folder = _made(Path(self.output_directory))
        comment = "Identified by the identification node from " + ", ".join(self.records)
        write_parameters(folder / PARAMETER_FILE, result.parameters, comment.replace("\n", " "))
        write_json(str(folder / RESULT_FILE), result.to_json())
        return (folder / RESULT_FILE).read_text(encoding="utf-8")


class JobProcess:
    """Runs one job at a time in a Python process; `kill` may come from any thread."""

    def __init__(self) -> None:
        self._running: subprocess.Popen[str] | None = None
        self._killed = False

    def run(self, job: Job) -> str:
        """The job's result, waited for without using the processor.

        Raises:
            InputError: what the job raised, or that it was ended.
        """
        self._running = subprocess.Popen(
            [sys.executable, "-m", __spec__.name],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            # Ctrl-C in a terminal is for the node, which then ends this process.
            start_new_session=True,
        )
        if self._killed:
            self._running.kill()
        output, errors = self._running.communicate(json.dumps(asdict(job)))
        status = self._running.returncode
        self._running = None
        if status == 0:
            return output
        if status == _BAD_INPUT:
            raise InputError(output.strip())
        if self._killed:
            raise InputError("identification: ended with its node")
        last = errors.strip().splitlines()[-1:] or [f"status {status}"]
        raise InputError(f"identification: failed: {last[0]}")

    def kill(self) -> None:
        """End the running job, and every later one."""
        self._killed = True
        running = self._running
        if running is not None:
            running.kill()


def records_inside(root: str, records: list[str]) -> list[str]:
    """Paths of `records`, relative ones below `root`; with a root, none may lie outside.

    Raises:
        InputError: no records, or one outside the root, `..` and links followed.
    """
    if not records:
        raise InputError("record: is empty, expected the path of one record or more")
    paths = [Path(root) / record for record in records]
    for path in paths:
        if root and not path.resolve().is_relative_to(Path(root).resolve()):
            raise InputError(f"record: {path} lies outside record_root {root}")
    return [str(path) for path in paths]


def _given(names: tuple[str, ...]) -> list[str]:
    # ROS cannot type an empty array: [""] stands for none.
    return [name for name in names if name]


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    return folder


def main() -> int:
    """A job as JSON on standard input, its result on standard output."""
    try:
        print(Job(**json.load(sys.stdin)).run(), end="")
    except InputError as error:
        print(error)
        return _BAD_INPUT
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
