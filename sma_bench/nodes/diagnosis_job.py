"""One diagnosis as a process of its own, and what its result says of the gap. No ROS."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

from sma_bench.nodes.job_process import (
    given,
    made_folder,
    output_inside,
    records_inside,
    run_job,
    tell,
)
from sma_bench.parameters import Parameters
from sma_bench.progress import part

NO_GAP = "no_gap"
_DIAGNOSED = 0.9  # of the time, about; the rest draws the report
_AT_NOISE = 1.05  # rms of the error over the noise of a sample


@dataclass(frozen=True)
class Job:
    """What to diagnose, and where files go; plain values that travel as JSON."""

    records: list[str]
    hold_out: list[str]
    improved: str
    report: str
    values: dict[str, Any]
    uncertainty: dict[str, float]

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any], parameters: Parameters) -> "Job":
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
        from sma_bench.commands.diagnose import diagnosis_steps, write_improved
        from sma_bench.commands.output import json_text
        from sma_bench.diagnose import diagnose
        from sma_bench.records import read_record

        records = [read_record(path) for path in self.records]
        held_out = [read_record(path) for path in self.hold_out]
        parameters = Parameters(self.values, self.uncertainty)
        share = _DIAGNOSED if self.report else 1.0
        told = diagnosis_steps(part(tell, 0.0, share))
        result = diagnose(records, parameters, held_out, told)
        if self.improved:
            made_folder(str(Path(self.improved).parent))
            write_improved(self.improved, result, "the diagnosis node")
        if self.report:
            from sma_bench.report.diagnosis_report import write_diagnosis_report

            write_diagnosis_report(self.report, result, part(tell, share, 1.0))
        return json_text(result.to_json())


@dataclass(frozen=True)
class GapState:
    """One line of `~/gap`: whether there is a gap, in words and in numbers."""

    name: str
    is_gap: bool
    message: str
    values: dict[str, str]


def gap_states(result: Mapping[str, Any]) -> list[GapState]:
    """The gap as a whole, and one state a measured quantity.

    Args:
        result: of a diagnosis, read from its JSON.
    """
    is_gap = result["verdict"] != NO_GAP
    where = {key: str(result["where"][key]) for key in ("signal", "phase", "side", "stage")}
    probability = f"{result['candidates'][0]['probability']:.3f}"
    whole = GapState(
        "sim-to-real gap", is_gap, _message(result),
        {"verdict": result["verdict"], "probability": probability, **where},
    )
    return [whole, *(_of(q, s, is_gap) for q, s in result["shrinkage"].items())]


def _message(result: Mapping[str, Any]) -> str:
    likely = [c["name"] for c in result["candidates"] if c["probability"] > 0.1]
    return {
        "effect": f"explained by {' and '.join(result['cause'])}",
        "recalibration": "the parameters are off",
        NO_GAP: "none beyond the noise",
        "ambiguous": f"one of {', '.join(likely)}",
        "unexplained": "no effect of the library explains it",
    }[result["verdict"]]


def _of(quantity: str, shrinkage: Mapping[str, Any], is_gap: bool) -> GapState:
    # JSON has null for a number that does not exist.
    numbers = {key: nan if value is None else value for key, value in shrinkage.items()}
    times = numbers["rmse_before"] / numbers["noise_floor"]
    shown = is_gap and times > _AT_NOISE
    message = f"{times:.1f} times the noise"
    if shown:
        message += f", {100.0 * numbers['fraction']:.0f} % of the gap gone with the improvement"
    keys = ("rmse_before", "rmse_after", "noise_floor", "fraction")
    values = {key: f"{numbers[key]:.4g}" for key in keys}
    return GapState(f"sim-to-real gap: {quantity}", shown, message, values)


if __name__ == "__main__":
    raise SystemExit(run_job(Job))
