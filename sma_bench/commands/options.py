"""What the command lines share: options, what may be written, examples in the help.

A command is a function of its options, which commands.yaml declares with examples beside:

    @options.command("info")
    def run(args: SimpleNamespace) -> int: ...
"""

import re
import shlex
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from pkgutil import resolve_name
from types import FrameType, SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import click
from click.shell_completion import CompletionItem

from sma_bench.border import load_yaml, read_yaml
from sma_bench.commands import COMMANDS
from sma_bench.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from sma_bench.parameters import Parameters
    from sma_bench.report.drawing import PaperColumn

Decorated = Callable[..., Any]


# --- A command.


class Command(click.Command):
    """Shows its examples below its options; refuses to replace what is there before any work."""

    examples: Sequence[str] = ()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """The arguments, once no output of theirs endangers a file."""
        ctx.obj = shlex.join([*ctx.command_path.split(), *args])
        rest = super().parse_args(ctx, self._one_value_each(args))
        if not ctx.resilient_parsing:
            outputs = {p.name or "": p for p in self.params if isinstance(p.type, Output)}
            values = ctx.params
            keep_safe(
                {
                    "/".join(option.opts): (Path(values[name]), option.type.kind)
                    for name, option in outputs.items()
                    if isinstance(option.type, Output)
                    and values[name] not in (None, STANDARD_OUTPUT)
                },
                paths_in(value for name, value in values.items() if name not in outputs),
                bool(values.get("force")),
            )
        return rest

    def _one_value_each(self, args: Sequence[str]) -> list[str]:
        """`--hold-out a b` as `--hold-out a --hold-out b`; all behind --ros-args as one."""
        several = {o for p in self.params if isinstance(p, Several) for o in p.opts}
        for_ros = any(p.name == "ros_args" for p in self.params)
        made: list[str] = []
        last = ""
        for k, arg in enumerate(args):
            if for_ros and arg == "--ros-args":
                return [*made, arg, shlex.join(args[k + 1 :])]
            if arg.startswith("-") and arg != "-" and not re.match(r"-\.?\d", arg):
                last = arg if arg in several else ""
            elif last and made[-1] != last:
                made.append(last)
            made.append(arg)
        return made

    def invoke(self, ctx: click.Context) -> Any:
        """Run it: results apart from what is for people, a polite kill as Ctrl-C."""
        if ctx.ignore_unknown_options:  # a node, which ends in its own way
            return super().invoke(ctx)
        with results_apart(ctx.params.get("json")), terminated_as_interrupted():
            return super().invoke(ctx)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The examples, as they are."""
        program = ctx.command_path.removesuffix(f" {self.name}")
        lines = "\n".join(f"  {program} {line}" for line in self.examples)
        formatter.write(f"\nexamples:\n{lines}\n")


def command(name: str, about: str = "", **settings: Any) -> Callable[[Decorated], Command]:
    """A command as commands.yaml declares it; its function gets the options as one namespace, and
    as `command_line` what was typed."""
    table = read_yaml(Path(__file__).with_name("commands.yaml"))
    rows: dict[str, Any] = {}
    for shown, row in table[name]["takes"].items():
        group = table["shared"].get(shown)
        rows |= {s: _filled(r, row) for s, r in group.items()} if group else {shown: row}
    params = [_parameter(shown, {"help": r} if isinstance(r, str) else r)
              for shown, r in rows.items()]  # fmt: skip
    if any(isinstance(p.type, Output) and p.type.kind != NEW for p in params):
        told = "replace outputs that exist (inputs never)"
        params.append(click.Option(["--force"], is_flag=True, help=told))
    settings.setdefault("context_settings", {"help_option_names": ["-h", "--help"]})

    def made(function: Decorated) -> Command:
        def body(**options: Any) -> Any:
            context = click.get_current_context()
            return function(SimpleNamespace(**options, command_line=context.obj))

        whole = Command(
            name, callback=body, params=params, help=about or COMMANDS[name], **settings
        )
        whole.examples = table[name]["examples"]
        return whole

    return made


def _filled(row: Any, words: str) -> Any:
    """A shared row with what a command says of it."""
    if isinstance(row, str):
        return row.replace("{}", words)
    return {**row, "help": row["help"].replace("{}", words)}


def _parameter(shown: str, row: Mapping[str, Any]) -> click.Parameter:
    """One of click from its row; `shown` is "--rate HZ", "--yes" (a flag), or of an argument
    RECORD, [RECORD], RECORD... or [RECORD...]."""
    settings: dict[str, Any] = {k: v for k, v in row.items() if k not in _OWN_SETTINGS}
    if "words" in row:
        settings["type"] = Words(row["words"], row.get("others", False))
    elif "writes" in row:
        settings["type"] = Output(row["writes"])
    elif "type" in row:
        settings["type"] = _TYPES[row["type"]]
    elif "several" in row or "name" in row:
        settings["type"] = Files()
    if "name" in row:
        return Argument(
            [row["name"]], metavar=shown, nargs=-1 if "..." in shown else 1,
            required=not shown.startswith("["), **settings,
        )  # fmt: skip
    option, _, metavar = shown.partition(" ")
    settings["metavar" if metavar else "is_flag"] = metavar or True
    kind = Several if "several" in row else click.Option
    return kind([option, *filter(None, [row.get("dest")])], **settings)


def run_command(whole: click.Command, path: str, arguments: Sequence[str]) -> int:
    """Run a command of this path, "sma-bench info" say; its exit status.

    Raises:
        InputError: it does not take these arguments.
    """
    try:
        with whole.make_context(path, list(arguments)) as context:
            return whole.invoke(context) or 0
    except click.exceptions.Exit as ended:  # --help
        return ended.exit_code
    except click.UsageError as error:
        raise InputError(f"{path.split()[-1]}: {_message(error)}; see {path} --help") from None


def _message(error: click.UsageError) -> str:
    if isinstance(error, click.NoSuchOption):
        known = error.ctx.command.params if error.ctx else []
        near = did_you_mean(error.option_name, (o for p in known for o in p.opts))
        return f"unknown option {error.option_name}{near}"
    words = " ".join(error.format_message().split()).rstrip(".")
    return words[:1].lower() + words[1:]


# --- Options and arguments.


class Argument(click.Argument):
    """A positional argument with a line in the help."""

    def __init__(self, *args: Any, help: str = "", **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.help = help

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:
        """What the help shows."""
        return self.metavar or self.human_readable_name, self.help or ""


class Several(click.Option):
    """An option with one value or more: `--hold-out a b`, or `--hold-out a --hold-out b`."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **{**settings, "multiple": True})


class Files(click.ParamType):
    """Files and folders, as far as completion goes."""

    name = "path"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The shell's own."""
        return [CompletionItem(incomplete, type="file")]


class Words(click.ParamType):
    """One of some words, or of those at MODULE:NAME, which are looked up when they are asked for:
    the help need not load what knows them. With `others` they are only what completion offers."""

    name = "word"

    def __init__(self, known: Sequence[str] | str, others: bool) -> None:
        self.known, self.others = known, others

    def words(self) -> list[str]:
        """All of them."""
        found = resolve_name(self.known) if isinstance(self.known, str) else self.known
        return list(found() if callable(found) else found)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The word itself."""
        known = self.words()
        if not self.others and value not in known:
            near = did_you_mean(value, known) or f", expected one of {', '.join(known)}"
            self.fail(f"{value!r}{near}", param, ctx)
        return value

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Those that begin so."""
        return [CompletionItem(word) for word in self.words() if word.startswith(incomplete)]


_OWN_SETTINGS = {"name", "dest", "words", "others", "writes", "several", "type"}
_TYPES = {"file": Files(), "float": float, "int": int, "unprocessed": click.UNPROCESSED}


def one_only(args: SimpleNamespace, *names: str, required: bool = False) -> None:
    """Refuse more than one of these options.

    Raises:
        InputError: it names them.
    """
    given = [name for name in names if getattr(args, name) not in (None, ())]
    if len(given) > 1 or (required and not given):
        options = " or ".join(f"--{name.replace('_', '-')}" for name in names)
        found = " and ".join(f"--{name}" for name in given) or "none"
        raise InputError(f"{found} given, expected {options}")


def parameters_from_options(args: SimpleNamespace) -> "Parameters":
    """Parameters of --params with the --set overrides applied.

    Raises:
        InputError: bad file, unknown name, wrong type or value, in one line.
    """
    from sma_bench.parameters import Parameters, read_parameters
    from sma_bench.parameters.node_tables import node_groups
    from sma_bench.parameters.yaml_file import split_names

    parameters = Parameters.defaults()
    if args.params:
        parameters = read_parameters(args.params, ignore=node_groups())
    values, uncertainty = split_names(dict(named_value(text) for text in args.overrides))
    return parameters.replace(values, uncertainty, "--set")


def named_value(text: str) -> tuple[str, Any]:
    """NAME=VALUE, the value as YAML has it.

    Raises:
        InputError: it is not that.
    """
    name, equals, value = text.partition("=")
    if not equals or not name:
        raise InputError(f"--set {text}: expected NAME=VALUE")
    try:
        return name.strip(), load_yaml(value)
    except InputError:
        raise InputError(f"--set {text}: {value!r} is not a value") from None


def column_of(args: SimpleNamespace) -> "PaperColumn | None":
    """The column for which figures are written.

    Raises:
        InputError: a width that no paper has, letters that nobody can read, or without a column.
    """
    if args.font is not None and (args.column is None or not 4.0 <= args.font <= 24.0):
        raise InputError(f"--font is {args.font:g} pt, expected 4 to 24 pt, and --column with it")
    if args.column is None:
        return None
    try:
        width = 0.0 if args.column in ("single", "double") else float(args.column)
    except ValueError:
        width = float("nan")
    if width and not 30.0 <= width <= 500.0:
        raise InputError(f"--column {args.column}: expected single, double or 30 to 500 mm")
    from sma_bench.report.drawing import COLUMNS  # matplotlib: half a second to load

    column = COLUMNS.get(args.column) or COLUMNS["double"]._replace(width=width)
    return column if args.font is None else column._replace(font=args.font)


def ros_arguments(args: SimpleNamespace) -> list[str]:
    """What rclpy.init takes."""
    return ["--ros-args", *shlex.split(args.ros_args)] if args.ros_args else []


# --- What a command may write: no output replaces what exists without --force, and no input ever.

STANDARD_OUTPUT = "-"
FILE, FOLDER, BAG, NEW, OWN = "file", "folder", "bag", "new folder", "own"
_RECORD = "metadata.yaml"


class Output(Files):
    """A path that is written; `kind`: FILE, FOLDER (of files with names of their own), BAG, NEW
    (never replaced), or OWN (the command calls `keep_safe` when it knows the files)."""

    def __init__(self, kind: str) -> None:
        self.kind = kind


def keep_safe(targets: Mapping[str, tuple[Path, str]], inputs: Sequence[Path], force: bool) -> None:
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
    texts = [text for value in values for text in (value if isinstance(value, tuple) else [value])]
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


# --- Results that are alone on standard output.

results: list[TextIO] = []
"""where results go to, last: standard output while people read standard error"""


@contextmanager
def results_apart(json_file: str | None) -> Iterator[None]:
    """Where the result goes to standard output as JSON, what is for people goes to standard
    error."""
    if json_file != STANDARD_OUTPUT:
        yield
        return
    results.append(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        results.pop()


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
