"""Second act of the demo: a composite bench hides an effect, and the diagnosis has to name it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from sma_bench.commands.demo_hidden import hidden_bench, hidden_effect, hidden_numbers
from sma_bench.commands.demo_reveal import confidently_wrong, reveal
from sma_bench.commands.demo_stage import Stage, recording_time
from sma_bench.commands.demo_table import SHARE
from sma_bench.commands.output import write_json
from sma_bench.commands.progress_bar import Course, progress
from sma_bench.commands.tables import print_table
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.progress import part
from sma_bench.results import gap_states, in_print
from sma_bench.share import share_directory

NAMESPACE = "/demo_gap"
RECORD, HOLD_OUT = "composite_diagnosis_triangles", "composite_diagnosis_steps"
# An Uno's own 5 V range. Over the usual 10 V, 10 bit are steps of 10 mV, far above the noise: a
# held level would be off by what heats the wire as much as a small effect.
INSTRUMENTS = {"sensor.voltage_resolution": 5.0 / 1023}
_LEAST_SHOWN = 0.005
_DIAGNOSING = 60.0  # s, about
_PATIENCE = 600.0
_Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


def gap_act(
    console: Console, out: Path, speed: float, seed: int, course: Course
) -> dict[str, Any]:
    """Hide an effect, diagnose, print the argument, then reveal.

    Returns:
        For the demo's JSON; `holds` is False if the diagnosis is confidently wrong.
    """
    lab_file = share_directory() / "config" / "demo_rig.yaml"
    hidden_file = out / "hidden.yaml"
    console.print("Synthetic: a simulated bench that hides an effect from its lab, real nodes.")
    lab = read_parameters(lab_file)
    plan = {name: recording_time(name, lab, speed) for name in (RECORD, HOLD_OUT)}
    plan["diagnose"] = _DIAGNOSING
    with (
        progress("demo", course) as report,
        Stage(out, NAMESPACE, part(report, SHARE, 1.0), plan) as stage,
    ):
        write_parameters(hidden_file, hidden_bench(lab, seed), "The truth of the simulated bench.")
        answer = _diagnosed(stage, out, hidden_file, lab_file, speed)
    write_json(str(out / "diagnosis.json"), answer)
    print_argument(console, answer)
    places = {"report": "report/index.html", "bags": "bags", "nodes load": "improved.yaml"}
    for what, name in places.items():
        console.print(f"{what:11}{escape(str(out / name))}", soft_wrap=True)
    # Only now does anybody but the bench's own nodes read the file.
    hidden = read_parameters(hidden_file)
    console.print(f"\n[bold]The truth[/], from {escape(str(hidden_file))}", soft_wrap=True)
    improved = read_parameters(out / "improved.yaml")
    for sentence in reveal(answer, hidden, lab, improved):
        console.print(escape(sentence), soft_wrap=True)
    console.print(f"The same again: --draw {seed}")
    truth = {"effect": hidden_effect(hidden), "numbers": dict(hidden_numbers(hidden))}
    return {
        "holds": not confidently_wrong(answer, hidden), "truth": truth, "draw": seed,
        "diagnosis": answer, "report": str(out / places["report"]),
    }


def _diagnosed(
    stage: Stage, out: Path, hidden_file: Path, lab_file: Path, speed: float
) -> dict[str, Any]:
    """Two bags of the bench, and what the diagnosis service says of them."""
    stage.start_bench(hidden_file, RECORD, {"speed": speed, **INSTRUMENTS})
    record, hold_out = stage.record(RECORD), stage.record(HOLD_OUT)
    stage.end_bench()
    stage.start_service("diagnosis", {}, (lab_file,))
    settings = {
        "record": [str(record)],
        "hold_out": [str(hold_out)],
        "improved": str((out / "improved.yaml").resolve()),
        "report": str((out / "report").resolve()),
    }
    return stage.ask("diagnosis", "diagnose", settings, _PATIENCE)


def print_argument(console: Console, answer: Mapping[str, Any]) -> None:
    """Verdict, probabilities, where, and how far the gap shrinks."""
    console.print(f"verdict    [bold]{escape(gap_states(answer)[0].message)}[/]")
    where = answer["where"]
    stage = f", {where['stage']} stage" if where["stage"] else ""
    console.print(
        f"where      {escape(where['signal'])}, {where['phase']}, {where['side']} side{stage}"
    )
    for headings, rows in (_candidates(answer), _shrinkage(answer)):
        print_table(console, headings, rows, range(1, len(headings)))


def _candidates(answer: Mapping[str, Any]) -> _Table:
    rows: list[tuple[str, ...]] = []
    for candidate in answer["candidates"]:
        if candidate["probability"] >= _LEAST_SHOWN:
            gap = candidate["gap_over_noise"]
            probability = f"{candidate['probability']:.3f}"
            rows.append((candidate["name"], probability, "" if gap is None else f"{gap:.1f}"))
    return ("candidate", "probability", "gap/noise"), rows


def _shrinkage(answer: Mapping[str, Any]) -> _Table:
    rows = []
    for quantity, s in answer["shrinkage"].items():
        numbers = [in_print(quantity, s[n]) for n in ("rmse_before", "rmse_after", "noise_floor")]
        # JSON has null for a number that does not exist.
        fraction, low, high = (
            "" if share is None else f"{100.0 * share:.0f}" for share in (s["fraction"], *s["ci90"])
        )
        rows.append((quantity, *numbers, f"{fraction} %", f"{low} to {high} %"))
    return ("held out", "rms before", "after", "noise", "gap gone", "90 % interval"), rows
