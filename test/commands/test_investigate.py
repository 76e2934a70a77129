"""sma-bench investigate: no cause after one record; after a simulated run the cause is named."""

import json

import pytest
from planted import believed, few_effects, planted_record, true_bench

from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.live.virtual_bench import SimulatedRun
from sma_bench.parameters import write_parameters
from sma_bench.progress import silent
from sma_bench.protocols import parse_protocol
from sma_bench.records import read_record
from sma_bench.tasks import jobs

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

# 2.1 K per minute are hidden in 20 s of deflection: other parameters explain it nearly as well.
WARMING = {"effect.ambient_drift.rate": 0.035}
LIBRARY = ("side_heat_coupling", "ambient_drift")


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    planted_record(folder / "short", WARMING, quantities=("deflection",))
    write_parameters(folder / "lab.yaml", believed(), names=sorted(believed().given))
    hidden = true_bench(WARMING)
    write_parameters(folder / "hidden.yaml", hidden, names=sorted(hidden.given))
    return folder


def investigate(lab, *more):
    files = f"--params {lab}/lab.yaml --folder {lab}/gap --simulated {lab}/hidden.yaml"
    words = ["investigate", f"{lab}/short", "--signals", "deflection", *files.split(), *more]
    with few_effects(LIBRARY):
        return main(words)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_inconclusive_record_is_followed_by_others_until_the_cause_is_named(lab, capsys):
    assert investigate(lab, "--budget", "0.1") == 0
    out = capsys.readouterr().out
    assert "budget spent: " in out and " after 1 record, 0.0 min" in out
    assert investigate(lab) == 0
    out = capsys.readouterr().out
    assert "--yes runs without asking" in out and not (lab / "gap" / "record_1").exists()
    assert investigate(lab, "--yes", "--json", str(lab / "story.json")) == 0
    story = json.loads((lab / "story.json").read_text())
    first, *_, last = story["chapters"]
    assert (first["cause"], first["records"]) == ([], 1)
    assert "ambient_drift" in first["proposed"]["separates"]
    assert (last["verdict"], last["cause"]) == ("effect", ["ambient_drift"])
    assert story["state"] == "named" and last["minutes"] > 0.5
    assert read_record(lab / "gap" / "record_1").duration > 30.0
    page = (lab / "gap" / "story" / "index.html").read_text()
    assert "ambient_drift explains the gap" in page and "SHA-256" in page  # its card comes first
    capsys.readouterr()
    assert investigate(lab) == 0  # no step is repeated
    assert "named: ambient_drift after 2 records" in capsys.readouterr().out


def test_a_simulated_run_ends_at_zero_volts_when_a_wire_gets_too_hot():
    limited = believed().replace({"bench.maximum_temperature": 310.0})
    steps = [{"kind": "step", "drive": "front", "level": 2.0, "duration": 20.0}]
    protocol = parse_protocol({"name": "hot", "steps": steps}, limited)
    run = SimulatedRun(believed(), limited, 1)
    with pytest.raises(InputError, match="hot: aborted: .*temperature"):
        run.follow(protocol)
    assert set(run._volts) == {0.0}


def test_an_investigation_needs_no_stated_parameters_but_its_own_folder(lab, tmp_path, capsys):
    assert main(["investigate", "--folder", str(tmp_path / "new")]) == 0
    assert "next: growing_triangles_1" in capsys.readouterr().out
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "improved.yaml").write_text("mine")
    assert investigate(lab, "--folder", str(tmp_path / "gap")) == 2
    assert "is not empty and holds no investigation" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "gap").iterdir()] == ["improved.yaml"]


CHAPTER = {"records": 1, "minutes": 0.0, "verdict": "ambiguous", "cause": [], "probabilities": {}}
PROPOSED = {"why": "", "protocol": [], "separates": ["a"], "minutes": "1"}
DAMAGED = [[], {"given": []}, {"given": "x", "chapters": []}, {"given": [5], "chapters": []},
           {"given": [], "chapters": {}}, {"given": [], "chapters": [[]]},
           *({"given": [], "chapters": [CHAPTER | change]} for change in (
               {"records": "two"}, {"cause": "x"}, {"probabilities": {"a": "b"}},
               {"proposed": {"why": 1}}, {"proposed": PROPOSED}))]  # fmt: skip


def tell(lab, folder, story):
    folder.mkdir(exist_ok=True)
    (folder / "believed.yaml").write_text((lab / "lab.yaml").read_text())
    (folder / "investigation.json").write_text(json.dumps(story))


@pytest.mark.parametrize("story", DAMAGED)
def test_a_manipulated_history_is_an_error_of_one_line(lab, tmp_path, capsys, story):
    tell(lab, tmp_path, story)
    assert investigate(lab, "--folder", str(tmp_path)) == 2
    said = capsys.readouterr().err
    assert "investigation.json: damaged: " in said and said.count("\n") == 1


def test_a_history_cannot_name_records_that_a_node_may_not_read(lab, tmp_path):
    tell(lab, tmp_path / "gap", {"given": [str(lab / "short")], "chapters": []})
    root = str(tmp_path)
    settings = {"record": [""], "record_root": root, "output_root": root, "folder": "gap",
                "signals": [""], "budget": 1.0}  # fmt: skip
    with pytest.raises(InputError, match="short lies outside record_root"):
        jobs.investigate(settings, believed(), silent)
