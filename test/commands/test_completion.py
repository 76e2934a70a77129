"""What a shell is offered, and what several values of an option and ROS's arguments become."""

import pytest

from sma_bench.cli import COMMANDS, load_command, main
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.physics.effects import EFFECTS


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("", list(COMMANDS)),
        ("di", ["diagnose"]),
        ("identify --exp", ["--experiment"]),
        ("identify --experiment E1", ["E1", "E10"]),
        ("identify my_", ["my_"]),
        ("identify my_bag --params ", ["FILE"]),
        ("diagnose --signals de", ["deflection"]),
        ("simulate --protocol composite_tri", ["composite_triangle"]),
        ("simulate --effect ", list(EFFECTS)),
        ("audit --set wire.res", ["wire.resistance"]),
        ("run ", list(NODE_TABLES)),
        ("calibrate supp", ["supply"]),
    ],
)
def test_a_shell_is_offered_what_may_follow(line, offered, monkeypatch, capsys):
    words = line.split(" ")
    monkeypatch.setenv("_SMA_BENCH_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_CWORD", str(len(words)))
    monkeypatch.setenv("COMP_WORDS", " ".join(["sma-bench", *words]))
    with pytest.raises(SystemExit):
        main([])
    shown = capsys.readouterr()
    assert shown.err == ""
    # A file is the shell's own.
    assert [line.partition(",")[2] or "FILE" for line in shown.out.splitlines()] == offered


def parsed(*words):
    return load_command(words[0]).make_context(words[0], list(words[1:])).params


def test_several_values_of_an_option_stand_behind_it_or_behind_each_of_it():
    wanted = ("a", "b")
    for words in (["--hold-out", "a", "b"], ["--hold-out", "a", "--hold-out", "b"]):
        found = parsed("diagnose", "bag", *words, "--params", "lab.yaml")
        assert found["hold_out"] == wanted and found["records"] == ("bag",)
    assert parsed("linearise", "--voltage", "-1", "2.5", "-3")["voltage"] == (-1.0, 2.5, -3.0)
    # What follows ros-args is for ROS.
    found = parsed("call", "a/b", "--json", "--ros-args", "-p", "x:=a b", "--set", "y")
    assert found["json"] == "-" and found["settings"] == ()
    assert found["ros_args"] == "-p 'x:=a b' --set y"
