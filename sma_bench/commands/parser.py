"""What every command line of sma-bench shares: parser, examples in its help, a polite kill."""

import argparse
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from sma_bench.errors import InputError

# --- An example or more of every command, as its --help shows them; a test runs each by its
# parser.

EXAMPLES: dict[str, tuple[str, ...]] = {
    "info": (
        "info my_bag",
        "info two_benches --namespace /left --json info.json",
    ),
    "import": (
        "import run.csv --params rig.yaml --out run",
        "import monday.xlsx tuesday.xlsx --map run.map.yaml --out week --json week.json",
    ),
    "identify": (
        "identify my_bag --params lab.yaml --out identified.yaml",
        "identify staircase ramp DSC.txt --report identified --json identified.json",
        "identify my_bag --experiment E1 --set wire.mass=0.09e-3",
    ),
    "diagnose": (
        "diagnose my_bag --params lab.yaml --hold-out other_bag --report gap",
        "diagnose my_bag --params lab.yaml --signals deflection --json diagnosis.json",
    ),
    "batch": (
        "batch identify bags/* --out identified --jobs 2",
        "batch diagnose monday tuesday --params lab.yaml --dask tcp://cluster:8786",
    ),
    "report": (
        "report my_bag --out my_report",
        "report my_bag identified.json diagnosis.json --params lab.yaml --out my_report",
    ),
    "audit": (
        "audit lab.yaml",
        "audit --set wire.resistance=2.8 --json audit.json",
    ),
    "parameters": (
        "parameters",
        "parameters --set wire.resistance=2.8 --out lab.yaml",
    ),
    "effects": (
        "effects",
        "effects --json effects.json",
    ),
    "simulate": (
        "simulate --protocol composite_triangle --params config/composite_rig.yaml --out made",
        "simulate --input my_bag --out again --effect latent_heat=12e3 --noise 1",
    ),
    "blind": (
        "blind make --seed 1 --n 20 --out cases",
        "blind run cases",
        "blind score cases",
    ),
    "blind make": ("blind make --seed 1 --n 20 --out cases --jobs 2",),
    "blind run": (
        "blind run cases --limit 5",
        "blind run cases --rival bic",
    ),
    "blind rival": ("blind rival bic my_bag --params lab.yaml --json answer.json",),
    "blind score": ("blind score cases --json score.json --page score",),
    "blind figures": ("blind figures --out symptoms",),
    "paper": (
        "paper --out paper",
        "paper staircase ramp --params lab.yaml --out paper --json paper.json",
    ),
    "calibrate": (
        "calibrate supply 5.91=6.00 8.87=9.01 11.83=12.02 --out lab.yaml",
        "calibrate front_current --csv front_current.csv --out lab.yaml",
    ),
    "dashboard": (
        "dashboard",
        "dashboard --namespace /lab --port 9000",
    ),
    "call": (
        "call experiment/start --set protocol=ramp",
        "call serial_bridge/enable --namespace /lab",
        "call identification/identify --set record=[my_record] --json result.json",
    ),
    "run": (
        "run simulator --ros-args -r __ns:=/bench --params-file config/wire_rig.yaml",
        "run experiment --ros-args -r __ns:=/bench -p protocol:=ramp",
        "run simulator --help",
    ),
    "demo": (
        "demo --quick",
        "demo --out my_demo --draw 7 --json demo.json",
    ),
    "completion": (
        "completion bash > ~/.local/share/bash-completion/completions/sma-bench",
        "completion zsh >> ~/.zshrc",
    ),
}


# --- The parser that every command shares: examples below the options, errors in one line.

PROGRAM = "sma-bench"


class CommandParser(argparse.ArgumentParser):
    """Raises InputError instead of printing the usage and an error below it."""

    def error(self, message: str) -> NoReturn:
        """One line that says what was wrong and where help is."""
        where = self.prog.removeprefix(PROGRAM).strip()
        said = f"{where}: {message}" if where else message
        raise InputError(f"{said}; see {self.prog} --help")


def command_parser(name: str, description: str | None) -> CommandParser:
    """An empty parser of `sma-bench name`, with the command's examples in its help."""
    return CommandParser(
        prog=f"{PROGRAM} {name}", description=description,
        epilog=example_text(EXAMPLES.get(name, ())),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def one_of(words: Callable[[], Iterable[str]]) -> Callable[[str], str]:
    """Type of an option that takes one of some words, which are looked up when it is used: the help
    need not load what knows them."""

    def checked(word: str) -> str:
        known = tuple(words())
        if word not in known:
            choices = ", ".join(map(repr, known))
            raise argparse.ArgumentTypeError(f"invalid choice: {word!r} (choose from {choices})")
        return word

    return checked


def example_text(examples: Sequence[str]) -> str:
    """Examples as they stand in a help text; empty without any."""
    if not examples:
        return ""
    return "\n".join(["examples:", *(f"  {PROGRAM} {example}" for example in examples)])


# --- A polite kill that tidies up as Ctrl-C does.

class Terminated(KeyboardInterrupt):
    """A polite kill. Python would end by SIGINT, whatever the exit code, had a plain
    KeyboardInterrupt passed through code that a library compiles from text."""


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """A polite kill tidies up as Ctrl-C does."""

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        raise Terminated

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
