"""What every command line of sma-bench shares: parser, examples in its help, a polite kill."""

import argparse
import re
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from sma_bench.errors import InputError, did_you_mean

COMMANDS = {
    "example": "the files of a documentation page, or a rig's parameters, in a new folder",
    "info": "what a record holds and whether it can be trusted",
    "import": "tables of other loggers (CSV, Excel, MATLAB, HDF5, Parquet) to bags",
    "identify": "parameters of Table I from bags and instrument files",
    "diagnose": "where simulation and bench disagree, which effect causes it, how far it shrinks",
    "investigate": "record, diagnose, propose, run, until the cause of the gap is named",
    "batch": "many records, each identified or diagnosed by itself, on all cores or a cluster",
    "compare": "records and models over each other, clocks aligned, worst difference in numbers",
    "report": "records and results as one page, with figures, tables and provenance",
    "audit": "do a lab's own numbers fit each other, and physics?",
    "parameters": "every parameter with unit, default, range and source",
    "effects": "what the paper's model leaves out: stage, size, how it shows",
    "linearise": "the linearised model (E11) about any operating point, printed and corrected",
    "simulate": "the paper's model on a protocol or on the voltages of a bag",
    "paper": "the paper's figures, tables and errata redrawn from data",
    "calibrate": "gain and offset of a sensor of the Uno from known loads",
    "dashboard": "a bench live in the browser, with a stop that works",
    "call": "call a service of a running node: sma-bench call experiment/start",
    "run": "run a node: sma-bench run NODE [--ros-args ...]",
    "demo": "simulated benches, bags, identification, diagnosis, in one go",
    "completion": "a script that completes commands and options in bash or zsh",
}

# What stood here before, and what does the same now.
RETIRED = {"blind": "judges the package and is no part of it; in a checkout: ./bench blind"}

# An example or more of every command, as its --help shows them; a test runs each by its parser.
EXAMPLES: dict[str, tuple[str, ...]] = {
    "example": (
        "example",
        "example ten_tasks",
        "example wire_rig --out my_rig",
    ),
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
    "investigate": (
        "investigate --params lab.yaml --folder gap --budget 20",
        "investigate my_bag --params lab.yaml --folder gap --simulated bench.yaml --yes",
    ),
    "batch": (
        "batch identify bags/* --out identified --jobs 2",
        "batch diagnose monday tuesday --params lab.yaml --dask tcp://cluster:8786",
    ),
    "compare": (
        "compare monday tuesday --out page",
        "compare monday --model lab.yaml --model improved.yaml --json difference.json",
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
    "linearise": (
        "linearise --params config/composite_rig.yaml",
        "linearise --params lab.yaml --deflection 0.02 --branch cooling --report tangent",
        "linearise --params lab.yaml --voltage 4.6 --json linear.json",
    ),
    "simulate": (
        "simulate --protocol composite_triangle --params config/composite_rig.yaml --out made",
        "simulate --input my_bag --out again --effect latent_heat=12e3 --noise 1",
    ),
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
        "demo --draw 3",
        "demo --out my_demo --draw 7 --json demo.json",
    ),
    "completion": (
        "completion bash > ~/.local/share/bash-completion/completions/sma-bench",
        "completion zsh >> ~/.zshrc",
    ),
}


# --- The parser that every command shares: examples below the options, errors in one line.

PROGRAM = "sma-bench"
_INVALID_CHOICE = re.compile(r"invalid choice: '([^']*)' \(choose from (.*)\)")


class CommandParser(argparse.ArgumentParser):
    """Raises InputError instead of printing the usage and an error below it, and before any work
    where an output would replace what is there."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The arguments, once no output of theirs endangers a file."""
        self._require_known_options(args or [])
        found = super().parse_args(args, namespace)
        values = vars(found)
        targets = {
            "/".join(action.option_strings): (Path(values[action.dest]), action.kind)
            for action in self._actions
            if isinstance(action, Output) and values[action.dest] not in (None, STANDARD_OUTPUT)
        }
        outputs = {action.dest for action in self._actions if isinstance(action, Output)}
        inputs = paths_in(value for name, value in values.items() if name not in outputs)
        keep_safe(targets, inputs, bool(values.get("force")))
        return found

    def _require_known_options(self, args: Sequence[str]) -> None:
        """A slip of the pen, before the parser complains of what it left unsaid."""
        known = set(self._option_string_actions)
        if any(a.nargs == argparse.REMAINDER and not a.option_strings for a in self._actions):
            return  # the rest has a parser of its own
        for argument in args:
            option = argument.partition("=")[0]
            if option in ("--", "--ros-args"):
                return
            if option.startswith("--") and not any(name.startswith(option) for name in known):
                self.error(f"unknown option {option}{did_you_mean(option, known)}")

    def error(self, message: str) -> NoReturn:
        """One line that says what was wrong and where help is."""
        where = self.prog.removeprefix(PROGRAM).strip()
        if choice := _INVALID_CHOICE.search(message):
            message += did_you_mean(choice[1], re.findall(r"[\w/.-]+", choice[2]))
        said = f"{where}: {message}" if where else message
        raise InputError(f"{said}; see {self.prog} --help")


def command_parser(name: str, description: str | None) -> CommandParser:
    """An empty parser of `sma-bench name`, with the command's examples in its help."""
    return CommandParser(
        prog=f"{PROGRAM} {name}", description=description,
        epilog=example_text(EXAMPLES.get(name, ())),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


# --- What a command may write: no output replaces what exists without --force, and no input ever.

STANDARD_OUTPUT = "-"
FILE, FOLDER, BAG, NEW, OWN = "file", "folder", "bag", "new folder", "checked by the command"
_RECORD = "metadata.yaml"


class Output(argparse.Action):
    """An option that names what is written; `kind`: FILE, FOLDER (of files with names of their
    own), BAG, NEW (never replaced), or OWN (the command calls `keep_safe` when it knows the
    files)."""

    def __init__(self, *args: Any, kind: str = FILE, **options: Any) -> None:
        super().__init__(*args, **options)
        self.kind = kind

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any,
        option_string: str | None = None,
    ) -> None:
        """Keep the path."""
        setattr(namespace, self.dest, values)


def add_output(parser: argparse.ArgumentParser, option: str, kind: str, **rest: Any) -> None:
    """Add an option that names what is written, and --force once."""
    parser.add_argument(option, action=Output, kind=kind, **rest)
    if kind != NEW and "--force" not in parser._option_string_actions:
        parser.add_argument(
            "--force", action="store_true", help="replace outputs that exist (inputs never)"
        )


def add_dask_option(parser: argparse.ArgumentParser, shared: str) -> None:
    """Add the address of a cluster."""
    parser.add_argument(
        "--dask", metavar="ADDRESS",
        help="on the workers of this dask scheduler instead, tcp://host:8786 say; they see "
        f"{shared} under the same path",
    )


def keep_safe(
    targets: Mapping[str, tuple[Path, str]], inputs: Sequence[Path], force: bool
) -> None:
    """Refuse outputs that would replace what is there.

    Args:
        targets: path and kind of each output, by a name for it.
        inputs: files and folders that are read; those of a bag count with it.
        force: whether what exists may be replaced; inputs never.

    Raises:
        InputError: the line names the output and what is in its way.
    """
    seen: dict[Path, str] = {}
    for option, (path, kind) in targets.items():
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            raise InputError(f"{path}: {other} and {option} name the same, expected two outputs")
        if not path.exists() or kind == OWN:
            continue
        given = next((name for name in inputs if _holds(path, name, kind)), None)
        if given is not None:
            raise InputError(f"{path}: an input, or the folder of one, expected a new path")
        if kind == NEW:
            raise InputError(f"{path}: exists already, expected a new folder")
        if kind == FOLDER and not path.is_dir():
            raise InputError(f"{path}: is not a folder, expected a new one")
        if kind == FOLDER and not any(path.iterdir()):
            continue
        if not force:
            what = "exists already" if kind != FOLDER else "exists already and is not empty"
            raise InputError(f"{path}: {what}, expected a new path; --force replaces it")
        if kind == BAG and not (path.is_dir() and (path / _RECORD).is_file()):
            raise InputError(f"{path}: is not a bag; --force replaces bags only")


def paths_in(values: Iterable[Any]) -> list[Path]:
    """Files and folders that exist, of the values of a command line."""
    texts = [text for value in values for text in (value if isinstance(value, list) else [value])]
    named = [Path(text) for text in texts if isinstance(text, str) and text and len(text) < 4096]
    return [path for path in named if _exists(path)]


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def _holds(output: Path, given: Path, kind: str) -> bool:
    """Whether replacing an output takes an input away."""
    if output.samefile(given):
        return True
    if kind != FILE and any(output.samefile(folder) for folder in given.resolve().parents):
        return True
    bag = given.is_dir() and (given / _RECORD).is_file()
    return bag and any(given.samefile(folder) for folder in output.resolve().parents)


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
