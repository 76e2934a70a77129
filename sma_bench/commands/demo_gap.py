"""Second act of the demo: a composite bench hides an effect, and the diagnosis has to name it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sma_bench.commands.demo_hidden import hidden_bench
from sma_bench.commands.demo_reveal import confidently_wrong, reveal
from sma_bench.commands.demo_stage import Stage
from sma_bench.commands.output import write_json
from sma_bench.nodes.diagnosis_job import gap_states
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.report.quantities import in_print
from sma_bench.share import share_directory

NAMESPACE = "/demo_gap"
RECORD, HOLD_OUT = "composite_diagnosis_triangles", "composite_diagnosis_steps"
# An Uno's own 5 V range. Over the usual 10 V, 10 bit are steps of 10 mV, far above the noise: a
# held level would be off by what heats the wire as much as a small effect.
INSTRUMENTS = {"sensor.voltage_resolution": 5.0 / 1023}
_LEAST_SHOWN = 0.005
# A diagnosis fits every effect of the library; it cannot report on the way.
_PATIENCE = 600.0


def gap_act(console: Console, out: Path, speed: float, seed: int) -> bool:
    """Hide an effect, diagnose, print the argument, then reveal; False if confidently wrong."""
    lab_file = share_directory() / "config" / "demo_rig.yaml"
    hidden_file = out / "hidden.yaml"
    console.print("Synthetic: a simulated bench that hides an effect from its lab, real nodes.")
    with Stage(console, out, NAMESPACE) as stage:
        lab = read_parameters(lab_file)
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
    return not confidently_wrong(answer, hidden)


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
    console.print(_candidates(answer), _shrinkage(answer), sep="\n")


def _candidates(answer: Mapping[str, Any]) -> Table:
    table = _table("candidate", "probability", "gap/noise")
    for candidate in answer["candidates"]:
        if candidate["probability"] >= _LEAST_SHOWN:
            gap = candidate["gap_over_noise"]
            table.add_row(
                candidate["name"], f"{candidate['probability']:.3f}",
                "" if gap is None else f"{gap:.1f}",
            )
    return table


def _shrinkage(answer: Mapping[str, Any]) -> Table:
    table = _table("held out", "rms before", "after", "noise", "gap gone", "90 % interval")
    for quantity, s in answer["shrinkage"].items():
        numbers = [in_print(quantity, s[n]) for n in ("rmse_before", "rmse_after", "noise_floor")]
        # JSON has null for a number that does not exist.
        fraction, low, high = (
            "" if share is None else f"{100.0 * share:.0f}" for share in (s["fraction"], *s["ci90"])
        )
        table.add_row(quantity, *numbers, f"{fraction} %", f"{low} to {high} %")
    return table


def _table(*headings: str) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column(headings[0], overflow="fold")
    for heading in headings[1:]:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
