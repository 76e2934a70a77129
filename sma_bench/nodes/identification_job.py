"""One identification as a process of its own. No ROS."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sma_bench.commands.output import write_json
from sma_bench.nodes.job_process import (
    given,
    made_folder,
    output_inside,
    records_inside,
    require_own,
    run_job,
    tell,
)
from sma_bench.parameters import Parameters, write_parameters

PARAMETER_FILE = "identified.yaml"
RESULT_FILE = "identified.json"


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
        from sma_bench.identify import identify
        from sma_bench.records import open_record

        records = [open_record(path) for path in self.records]
        parameters = Parameters(self.values, self.uncertainty)
        result = identify(records, parameters, self.experiments or None, tell)
        folder = made_folder(self.output_directory)
        files = folder / PARAMETER_FILE, folder / RESULT_FILE
        require_own(*files, parameter="output_directory")
        comment = "Identified by the identification node from " + ", ".join(self.records)
        write_parameters(folder / PARAMETER_FILE, result.parameters, comment.replace("\n", " "))
        write_json(str(folder / RESULT_FILE), result.to_json())
        return (folder / RESULT_FILE).read_text(encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(run_job(Job))
