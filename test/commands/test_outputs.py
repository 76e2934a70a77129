"""Nothing lost by accident: no command replaces what exists without --force, and no input ever."""

import shutil
from pathlib import Path

import click
import pytest

from sma_bench.cli import COMMANDS, load_command, main
from sma_bench.commands.options import BAG, FILE, FOLDER, NEW, OWN, Output

PARAMETERS = [
    (name, parameter) for name in COMMANDS if name != "run"
    for parameter in load_command(name).params if isinstance(parameter, click.Option)
]
# What each command takes besides its outputs; IN stands for an input that exists.
WORDS = {
    "info": ["IN"], "import": ["IN", "--out", "OUT"], "identify": ["IN"], "diagnose": ["IN"],
    "compare": ["IN"], "audit": ["IN"],
    "batch": ["identify", "IN"], "report": ["IN", "--out", "OUT"],
    "parameters": ["--params", "IN"], "effects": [], "simulate": ["--input", "IN", "--out", "OUT"],
    "paper": ["IN", "--out", "OUT"], "calibrate": ["supply", "--csv", "IN"], "call": ["a/b"],
    "investigate": ["IN", "--folder", "OUT", "--simulated", "IN"],
    "demo": [], "linearise": ["--params", "IN"], "dashboard": [], "example": ["ten_tasks"],
}
READS_NO_FILE = {"effects", "call", "demo", "example"}
# Options that name files which a command reads, and others that look alike but name none.
READ = {
    "--params", "--model", "--hold-out", "--map", "--input", "--csv", "--program", "--simulated",
}
# An investigation is always kept.
RESUMED = {("investigate", "--folder")}


def outputs(kinds: set[str]) -> list[tuple[str, str, str]]:
    return [
        (name, option.opts[0], option.type.kind) for name, option in PARAMETERS
        if isinstance(option.type, Output) and option.type.kind in kinds
    ]


def words_for(name: str, option: str, target: Path, given: Path, tmp_path: Path) -> list[str]:
    words = list(WORDS[name])
    if option in words:
        words[words.index(option) + 1] = str(target)
    else:
        words += [option, str(target)]
    places = {"IN": str(given), "OUT": str(tmp_path / "elsewhere")}
    return [*name.split(), *(places.get(word, word) for word in words)]


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def precious(tmp_path: Path) -> tuple[Path, Path]:
    """A file and a folder that looks like a bag, both worth keeping."""
    file, folder = tmp_path / "precious.txt", tmp_path / "precious"
    file.write_text("years of work\n")
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    return file, folder


def test_every_option_that_names_what_is_written_is_declared() -> None:
    undeclared = [
        (name, option.opts[0]) for name, option in PARAMETERS
        if str(option.metavar).removesuffix(" ...").endswith(("FILE", "DIR", "BAG", ".yaml"))
        and not isinstance(option.type, Output)
        and not READ.intersection(option.opts) and (name, option.opts[0]) not in RESUMED
    ]
    assert undeclared == []
    assert {name for name, option, _ in outputs({FILE, FOLDER, BAG, NEW, OWN})} >= {
        "identify", "simulate", "diagnose", "import", "report", "paper", "parameters", "demo",
        "batch", "calibrate",
    }


@pytest.mark.parametrize(("name", "option", "kind"), outputs({FILE, FOLDER, BAG, NEW}))
def test_what_exists_is_not_replaced(name, option, kind, precious, tmp_path, capsys) -> None:
    file, folder = precious
    given = tmp_path / "given.csv"
    given.write_text("1,2\n")
    target = file if kind == FILE else folder
    before = content(tmp_path)
    assert main(words_for(name, option, target, given, tmp_path)) == 2
    said = capsys.readouterr().err
    assert "exists already" in said and said.count("\n") == 1
    assert ("--force replaces it" in said) == (kind != NEW)
    assert content(tmp_path) == before


@pytest.mark.parametrize("kept", ["given.csv", "linked.csv"])
@pytest.mark.parametrize(
    ("name", "option", "kind"),
    [one for one in outputs({FILE}) if one[0] not in READS_NO_FILE],
)
def test_an_input_is_not_replaced_even_by_force(
    name, option, kind, kept, tmp_path, capsys
) -> None:
    given = tmp_path / "given.csv"
    given.write_text("1,2\n")
    (tmp_path / "linked.csv").symlink_to(given)
    words = words_for(name, option, tmp_path / kept, given, tmp_path)
    assert main([*words, "--force"]) == 2
    assert "an input, or the folder of one" in capsys.readouterr().err
    assert given.read_text() == "1,2\n"


@pytest.mark.parametrize(
    ("name", "option", "kind"),
    [one for one in outputs({FOLDER, BAG}) if one[0] not in READS_NO_FILE],
)
def test_the_folder_of_an_input_is_not_replaced_even_by_force(
    name, option, kind, precious, tmp_path, capsys
) -> None:
    _, folder = precious
    given = folder / "run.mcap"
    given.write_bytes(b"samples")
    before = content(tmp_path)
    for one in (given, folder):
        assert main([*words_for(name, option, folder, one, tmp_path), "--force"]) == 2
        assert "an input, or the folder of one" in capsys.readouterr().err
    assert content(tmp_path) == before


def test_what_lies_in_a_bag_that_is_read_is_part_of_the_input(precious, capsys) -> None:
    _, bag = precious
    inside = bag / "metadata.yaml"
    assert main(["info", str(bag), "--json", str(inside), "--force"]) == 2
    assert "an input" in capsys.readouterr().err
    assert inside.read_text() == "rosbag2_bagfile_information: {}\n"


def test_two_outputs_of_one_name_are_refused(tmp_path, capsys) -> None:
    path = str(tmp_path / "both")
    assert main(["parameters", "--out", path, "--json", path]) == 2
    assert "--out and --json name the same" in capsys.readouterr().err
    assert not Path(path).exists()


def test_force_replaces_files_and_bags_and_nothing_else(tmp_path, precious, capsys) -> None:
    file, _ = precious
    assert main(["effects", "--json", str(file), "--force"]) == 0
    assert "latent_heat" in file.read_text()
    words = ["simulate", "--protocol", "ramp", "--rate", "10", "--out", str(tmp_path / "bag")]
    assert main(words) == 0
    first = content(tmp_path / "bag")
    assert main(words) == 2
    assert content(tmp_path / "bag") == first
    assert main([*words, "--force", "--noise", "1"]) == 0
    assert content(tmp_path / "bag").keys() == first.keys()
    assert content(tmp_path / "bag") != first
    shutil.rmtree(tmp_path / "bag")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "thesis.txt").write_text("no bag\n")
    capsys.readouterr()
    assert main([*words, "--force"]) == 2
    assert "is not a bag; --force replaces bags only" in capsys.readouterr().err
    assert (tmp_path / "bag" / "thesis.txt").read_text() == "no bag\n"


def test_a_calibration_joins_the_others_and_replaces_its_own_by_force_only(
    tmp_path, capsys
) -> None:
    out = tmp_path / "lab.yaml"
    one = ["calibrate", "supply", "5.91=6.00", "8.87=9.01", "11.83=12.02", "--out", str(out)]
    other = ["calibrate", "front_current", "0.1=0.0", "1.1=1.0", "2.1=2.0", "--out", str(out)]
    assert main(one) == 0 and main(other) == 0
    both = out.read_text()
    assert "supply" in both and "front_current" in both
    assert main(one) == 2
    assert "--force replaces it" in capsys.readouterr().err
    assert out.read_text() == both
    assert main([*one, "--force"]) == 0


def test_batch_replaces_no_result_of_an_earlier_run(tmp_path, capsys) -> None:
    record, out = tmp_path / "run", tmp_path / "results"
    record.write_text("not read\n")
    out.mkdir()
    (out / "run.json").write_text("kept\n")
    assert main(["batch", "identify", str(record), "--out", str(out)]) == 2
    assert "run.json: exists already" in capsys.readouterr().err
    assert (out / "run.json").read_text() == "kept\n"


def test_import_replaces_no_bag_among_several(tmp_path, capsys) -> None:
    tables = [tmp_path / f"{day}.csv" for day in ("monday", "tuesday")]
    for table in tables:
        table.write_text("time_s,voltage_V\n0,1\n1,2\n")
    (tmp_path / "week" / "tuesday").mkdir(parents=True)
    words = ["import", *map(str, tables), "--out", str(tmp_path / "week")]
    assert main(words) == 2
    assert "tuesday: exists already" in capsys.readouterr().err
    assert not (tmp_path / "week" / "monday").exists()
