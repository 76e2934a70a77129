"""The completion script, asked by a real bash."""

import shutil
import subprocess

import pytest

from sma_bench.cli import COMMANDS, main
from sma_bench.commands.completion import completion_script
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.physics.effects import EFFECTS

ASK = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
_sma_bench
printf '%s\\n' "${COMPREPLY[@]}"
complete -p sma-bench bench > /dev/null
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    if shutil.which("bash") is None:
        pytest.skip("no bash")
    path = tmp_path_factory.mktemp("completion") / "script"
    path.write_text(completion_script("bash"))
    return path


def completed(script, *words):
    """What bash offers for the last of the words."""
    command = ["bash", "--norc", "-c", ASK, "bash", str(script), "sma-bench", *words]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0 and process.stderr == ""
    return process.stdout.split()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ([""], list(COMMANDS)),
        (["di"], ["diagnose"]),
        (["identify", "--exp"], ["--experiment"]),
        (["identify", "--experiment", "E1"], ["E1", "E10"]),
        (["identify", "my_"], []),
        (["identify", "my_bag", "--params", ""], []),
        (["diagnose", "--signals", "de"], ["deflection"]),
        (["simulate", "--protocol", "composite_tri"], ["composite_triangle"]),
        (["simulate", "--effect", ""], list(EFFECTS)),
        (["audit", "--set", "wire.res"], ["wire.resistance"]),
        (["run", "ser"], ["serial_bridge"]),
        (["run", ""], sorted(NODE_TABLES)),
        (["calibrate", "supp"], ["supply"]),
        (["calibrate", "supply", "s"], []),
        (["completion", ""], ["bash", "zsh"]),
    ],
)
def test_bash_offers_what_may_follow(script, words, offered):
    assert completed(script, *words) == offered


def test_every_option_of_a_command_is_offered(script):
    offered = completed(script, "report", "--")
    assert {"--out", "--title", "--params", "--json", "--set", "--help"} <= set(offered)


def test_zsh_reads_the_same_by_its_bash_mode(capsys):
    assert main(["completion", "zsh"]) == 0
    first, rest = capsys.readouterr().out.split("\n", 1)
    assert "completion zsh" in first and rest.startswith("autoload")
    assert "complete -o default -F _sma_bench sma-bench bench" in rest
