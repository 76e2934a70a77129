"""Shared by all commands: options as declared in commands.yaml, and the rules for outputs."""

import math
import re
import shlex
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from pathlib import Path
from pkgutil import resolve_name
from types import FrameType, SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import click
from click.shell_completion import CompletionItem

from sma_bench.border import claimed, load_yaml, read_yaml
from sma_bench.commands import COMMANDS
from sma_bench.errors import InputError, did_you_mean, errors_in

if TYPE_CHECKING:
    from sma_bench.parameters import Parameters
    from sma_bench.report.drawing import PaperColumn
    from sma_bench.report.page import Made

STANDARD_OUTPUT = "-"
FILE, FOLDER, BAG, NEW, OWN = "file", "folder", "bag", "new folder", "own"
"""kinds of output: a file; a folder of files with fixed names; a bag; a folder that is never
replaced; paths that the command checks itself by `keep_safe`, once it knows them"""
_BAG_FILE = "metadata.yaml"
_DECLARED = read_yaml(Path(__file__).with_name("commands.yaml"))
_LONGEST_PATH = 4096
_NARROWEST, _WIDEST = 30.0, 500.0  # mm, width of a printed column

results: list[TextIO] = []  # the last: standard output of the running command, for its JSON


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM. Not a plain KeyboardInterrupt: once that has passed through code compiled
    from text by a library, Python ends as by SIGINT, whatever the exit code."""


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise Terminated


class Argument(click.Argument):
    """A positional argument with a line in the help."""

    def __init__(self, *args: Any, help: str = "", **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.help = help

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:
        return self.metavar or self.human_readable_name, self.help or ""


class Several(click.Option):
    """An option with one value or more: `--hold-out a b`, or `--hold-out a --hold-out b`."""


class Output(click.Path):
    """A path to write, of one of the kinds above."""

    def __init__(self, kind: str) -> None:
        super().__init__(readable=False)  # `keep_safe` judges what is there
        self.kind = kind


class Words(click.ParamType):
    """One of some words, or of those at MODULE:NAME, which is imported only when they are needed:
    the help must load quickly. With `others`, other values are accepted too."""

    name = "word"

    def __init__(self, known: Sequence[str] | str, others: bool) -> None:
        self.known, self.others = known, others

    def words(self) -> list[str]:
        found = resolve_name(self.known) if isinstance(self.known, str) else self.known
        return list(found() if callable(found) else found)

    def convert(self, value: Any, param: Any, ctx: Any) -> str:
        if not self.others and value not in (known := self.words()):
            near = did_you_mean(value, known) or f", expected one of {', '.join(known)}"
            self.fail(f"{value!r}{near}", param, ctx)
        return str(value)

    def shell_complete(self, ctx: Any, param: Any, incomplete: str) -> list[CompletionItem]:
        return [CompletionItem(word) for word in self.words() if word.startswith(incomplete)]


class Number(click.FloatRange):
    """A finite number in a range."""

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number", param, ctx)
        return number


_TYPES: dict[str, type[click.ParamType]] = {
    "file": click.Path, "float": Number, "int": click.IntRange,
    "unprocessed": click.types.UnprocessedParamType}


def _parameter(shown: str, row: dict[str, Any]) -> click.Parameter:
    """A click parameter from its row. `shown`: "--rate HZ", "--yes" (flag), RECORD, [RECORD...]."""
    name, dest, several = row.pop("name", None), row.pop("dest", None), row.pop("several", False)
    kind, writes, words = row.pop("type", None), row.pop("writes", None), row.pop("words", None)
    if words is not None:
        row["type"] = Words(words, row.pop("others", False))
    elif writes is not None:
        row["type"] = Output(writes)
    elif kind or several or name:
        row["type"] = _TYPES[kind or "file"](*row.pop("range", ()))
    if name:
        row |= {"nargs": -1 if "..." in shown else 1, "required": not shown.startswith("[")}
        return Argument([name], metavar=shown, **row)
    option, _, metavar = shown.partition(" ")
    row |= {"metavar": metavar} if metavar else {"is_flag": True}
    names = [option, *([dest] if dest else [])]
    return Several(names, multiple=True, **row) if several else click.Option(names, **row)


class Command(click.Command):
    """Shows examples below its options; checks its outputs before any work is done."""

    examples: Sequence[str] = ()

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; "--option a b" becomes "--option a --option b". InputError: an unsafe output."""
        ctx.obj = shlex.join([*ctx.command_path.split(), *args])
        several = {o for p in self.params if isinstance(p, Several) for o in p.opts}
        for_ros = any(p.name == "ros_args" for p in self.params)
        made, last = list[str](), ""
        for k, arg in enumerate(args):
            if for_ros and arg == "--ros-args":
                made += [arg, shlex.join(args[k + 1 :])]
                break
            if arg.startswith("-") and arg != "-" and not re.match(r"-\.?\d", arg):
                last = arg if arg in several else ""
            elif last and made[-1] != last:
                made.append(last)
            made.append(arg)
        rest = super().parse_args(ctx, made)
        if not ctx.resilient_parsing:
            written = {"/".join(p.opts): (Path(value), p.type.kind) for p in self.params
                       if isinstance(p.type, Output) and p.name
                       and (value := ctx.params[p.name]) not in (None, STANDARD_OUTPUT)}
            read = [p.name for p in self.params if p.name and not isinstance(p.type, Output)]
            given = paths_in(ctx.params.get(name) for name in read)
            try:
                claim_outputs(path for path, _ in written.values())
                keep_safe(written, given, bool(ctx.params.get("force")))
            except InputError:
                ctx.close()
                raise
        return rest

    def invoke(self, ctx: click.Context) -> Any:
        """Run it. With JSON on standard output, all other text goes to standard error."""
        if ctx.ignore_unknown_options:  # a node, which handles signals itself
            return super().invoke(ctx)
        apart = ctx.params.get("json") == STANDARD_OUTPUT
        results.append(sys.stdout)
        before = signal.signal(signal.SIGTERM, _interrupt)
        try:
            with redirect_stdout(sys.stderr) if apart else nullcontext():
                return super().invoke(ctx)
        finally:
            signal.signal(signal.SIGTERM, before)
            results.pop()

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        program = ctx.command_path.removesuffix(f" {self.name}")
        lines = "\n".join(f"  {program} {line}" for line in self.examples)
        formatter.write(f"\nexamples:\n{lines}\n")


def command(name: str, about: str = "",
            **context: Any) -> Callable[[Callable[[SimpleNamespace], int]], Command]:
    """A command as declared in commands.yaml. Its function gets the options and `command_line`."""
    rows: dict[str, dict[str, Any]] = {}
    for shown, row in _DECLARED[name]["takes"].items():
        # The text of this command replaces {} in a shared row.
        for own, filled in _DECLARED["shared"].get(shown, {shown: row}).items():
            rows[own] = {"help": filled} if isinstance(filled, str) else dict(filled)
            if shown in _DECLARED["shared"]:
                rows[own]["help"] = rows[own]["help"].replace("{}", str(row))
    params = [_parameter(shown, row) for shown, row in rows.items()]
    if any(isinstance(p.type, Output) and p.type.kind != NEW for p in params):
        params.append(click.Option(["--force"], is_flag=True,
                                   help="replace outputs that exist (inputs never)"))
    context["help_option_names"] = ["-h", "--help"]

    def made(function: Callable[[SimpleNamespace], int]) -> Command:
        def body(**options: Any) -> int:
            options["command_line"] = click.get_current_context().obj
            return function(SimpleNamespace(**options))

        whole = Command(name, callback=body, params=params, help=about or COMMANDS[name],
                        context_settings=context)
        whole.examples = _DECLARED[name]["examples"]
        return whole

    return made


def run_command(whole: click.Command, path: str, arguments: Sequence[str]) -> int:
    """Run a command, e.g. "sma-bench info"; its exit status. InputError: wrong arguments."""
    try:
        with whole.make_context(path, list(arguments)) as context:
            return whole.invoke(context) or 0
    except click.exceptions.Exit as ended:  # --help
        return ended.exit_code
    except click.NoSuchOption as error:
        known = (o for p in whole.params for o in p.opts)
        problem = f"unknown option {error.option_name}{did_you_mean(error.option_name, known)}"
    except click.UsageError as error:
        words = " ".join(error.format_message().split()).rstrip(".")
        problem = words[:1].lower() + words[1:]
    raise InputError(f"{path.split()[-1]}: {problem}; see {path} --help")


def one_only(args: SimpleNamespace, *names: str, required: bool = False) -> None:
    """Raises InputError: more than one of these options is given, or none if `required`."""
    given = [f"--{name}" for name in names if getattr(args, name) not in (None, ())]
    if len(given) > 1 or (required and not given):
        expected = " or ".join(f"--{name}" for name in names)
        raise InputError(f"{' and '.join(given) or 'none'} given, expected {expected}")


def stated_by(args: SimpleNamespace) -> str:
    """The parameter file and what --set changes, for the text of a page."""
    return ", ".join(filter(None, [args.params, *args.overrides]))


def parameters_from_options(args: SimpleNamespace) -> "Parameters":
    """Parameters of --params with --set applied. InputError: bad file, name, type or value."""
    from sma_bench.parameters import Parameters, read_parameters

    parameters = read_parameters(args.params) if args.params else Parameters.defaults()
    return parameters.replace(dict(map(named_value, args.overrides)), where="--set")


def pair(option: str, text: str, form: str = "NAME=VALUE") -> tuple[str, str]:
    """Name and value of an option's text; a FILE may contain =. InputError: not of this form."""
    name, _, value = text.rpartition("=") if form.startswith("FILE") else text.partition("=")
    if "=" not in text or not name:
        raise InputError(f"{option} {text}: expected {form}")
    return name.strip(), value


def named_value(text: str) -> tuple[str, Any]:
    """Name and value of --set NAME=VALUE, the value parsed as YAML. InputError: not that form."""
    name, value = pair("--set", text)
    try:
        return name, load_yaml(value)
    except InputError:
        raise InputError(f"--set {text}: {value!r} is not a value") from None


def column_of(args: SimpleNamespace) -> "PaperColumn | None":
    """Column width and font of the figures. InputError: a wrong width, a font without a column."""
    if args.column is None:
        if args.font is not None:
            raise InputError(f"--font is {args.font:g} pt, expected --column with it")
        return None
    from sma_bench.report.drawing import COLUMNS  # matplotlib: half a second to load

    column = COLUMNS.get(args.column)
    if column is None:
        with suppress(ValueError):
            column = COLUMNS["double"]._replace(width=float(args.column))
        if column is None or not _NARROWEST <= column.width <= _WIDEST:
            wanted = f"single, double or {_NARROWEST:g} to {_WIDEST:g} mm"
            raise InputError(f"--column {args.column}: expected {wanted}")
    return column if args.font is None else column._replace(font=args.font)


def namespace_of(text: str | None) -> str:
    """The namespace of a bench's nodes; /bench by default."""
    return "/" + (text or "bench").strip("/")


@contextmanager
def needs_ros(name: str, hint: str = "source a ROS 2 Jazzy setup file") -> Iterator[None]:
    """Wraps the imports that a command needs. Raises InputError: a module is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("sma_bench"):
            raise
        raise InputError(f"{name}: {error.name} is not installed: {hint}, or use ./bench") from None


def ros_arguments(args: SimpleNamespace) -> list[str]:
    return ["--ros-args", *shlex.split(args.ros_args)] if args.ros_args else []


def provenance_of(args: SimpleNamespace, *inputs: Sequence[str]) -> "Made":
    """The provenance of a page: the command line, its inputs and its parameter file."""
    from sma_bench.report.page import Made

    files = [*(path for several in inputs for path in several), getattr(args, "params", None)]
    return Made(args.command_line, [*filter(None, files)])


# --- Outputs: none replaces an existing file without --force, and none ever replaces an input.


def keep_safe(targets: Mapping[str, tuple[Path, str]], inputs: Sequence[Path], force: bool) -> None:
    """Raises InputError: an output would replace an existing file. `targets`: path and kind of each
    output, by option; `inputs`: files and folders that are read (a bag with its files) and never
    replaced; `force`: other files may be replaced."""
    seen: dict[Path, str] = {}
    for option, (path, kind) in targets.items():
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            raise InputError(f"{path}: given for {other} and {option}, expected two paths")
        with errors_in(f"{path}: cannot be written"):  # a name too long
            is_there = path.exists()
        if not is_there or kind == OWN:
            continue
        for given in inputs:
            # The output is the input, a folder above it, or a part of a bag that is read.
            above = [] if kind == FILE else given.resolve().parents
            bag = [given] if (given / _BAG_FILE).is_file() else []
            if any(path.samefile(folder) for folder in (given, *above)) or any(
                own.samefile(folder) for own in bag for folder in path.resolve().parents
            ):
                raise InputError(f"{path}: is an input or contains one, expected a new path")
        if kind == NEW:
            raise InputError(f"{path}: exists already, expected a new folder")
        if kind == FOLDER and not path.is_dir():
            raise InputError(f"{path}: is not a folder, expected a new one")
        if kind == FOLDER and not any(path.iterdir()):
            continue
        if not force:
            what = "exists already" if kind != FOLDER else "exists already and is not empty"
            raise InputError(f"{path}: {what}, expected a new path; --force replaces it")
        if kind == BAG and not (path / _BAG_FILE).is_file():
            raise InputError(f"{path}: is not a bag; --force replaces bags only")


def claim_outputs(paths: Iterable[Path]) -> None:
    """Claim outputs until this command ends. InputError: another command is writing one."""
    for path in {path.resolve() for path in paths}:
        click.get_current_context().with_resource(claimed(str(path), "being written already"))


def paths_in(values: Iterable[Any]) -> list[Path]:
    """The existing files and folders among the values of a command line."""
    words = [w for value in values for w in (value if isinstance(value, tuple) else [value])]
    found = []
    for word in words:
        if isinstance(word, str) and 0 < len(word) < _LONGEST_PATH:
            with suppress(OSError, ValueError):
                found += [Path(word)] if Path(word).exists() else []
    return found
