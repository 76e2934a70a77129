"""sma-bench completion SHELL: a script that completes commands, options and names.

Made from the parsers of this version, so that a press of TAB starts no Python.
"""

import argparse
import importlib
from collections.abc import Callable, Iterable

from sma_bench.commands.diagnose import quantities
from sma_bench.commands.identify import experiments
from sma_bench.commands.parser import CommandParser, command_parser
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameter import EFFECT_NAMES
from sma_bench.parameters.table import BY_NAME

SHELLS = ("bash", "zsh")

_SCRIPT = """# Completes sma-bench, and ./bench, in bash; made by: sma-bench completion {shell}
{first}_sma_bench() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}"
    local command="${{COMP_WORDS[1]}}" place=$COMP_CWORD
    COMPREPLY=()
    if [[ $COMP_CWORD -eq 1 ]]; then
        COMPREPLY=($(compgen -W "{commands}" -- "$word"))
        return
    fi
    case "$command $before" in
{values}
    esac
    case "$word" in
        -*) case "$command" in
{options}
        esac ;;
        *) [[ $place -eq 2 ]] && case "$command" in
{words}
        esac ;;
    esac
}}
complete -o default -F _sma_bench sma-bench bench
"""
_FIRST = {"bash": "", "zsh": "autoload -U +X compinit bashcompinit && compinit && bashcompinit\n"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("shell", choices=SHELLS, help="shell to complete in")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    print(completion_script(args.shell), end="")
    return 0


def completion_script(shell: str) -> str:
    """The whole script; it has to be made again for another version."""
    from sma_bench.commands.parser import COMMANDS

    names = [n for n in COMMANDS if n != "run"]
    parsers = {
        name: _parser(name, importlib.import_module(f"sma_bench.commands.{name}").add_arguments)
        for name in names
    }
    words = {name: _positional(parser) for name, parser in parsers.items()}
    words["run"] = sorted(NODE_TABLES)
    options = {name: sorted(parser._option_string_actions) for name, parser in parsers.items()}
    values = [
        _reply(f"{name} {option}", choices, 8, "; return")
        for name, parser in parsers.items()
        for action in parser._actions
        for option in action.option_strings
        if (choices := _choices(action))
    ]
    return _SCRIPT.format(
        shell=shell, first=_FIRST[shell], commands=" ".join(COMMANDS), values="\n".join(values),
        options="\n".join(_reply(name, found, 12) for name, found in options.items()),
        words="\n".join(_reply(name, found, 12) for name, found in words.items() if found),
    )


def _parser(name: str, add: Callable[[CommandParser], None]) -> CommandParser:
    parser = command_parser(name, None)
    add(parser)
    return parser


def _positional(parser: argparse.ArgumentParser) -> list[str]:
    """Words that the first positional argument may be; none where it is a file."""
    first = next((a for a in parser._actions if not a.option_strings), None)
    return [str(word) for word in (first.choices or ())] if first else []


def _choices(action: argparse.Action) -> list[str]:
    """Words that may follow an option."""
    if action.choices:
        return [str(choice) for choice in action.choices]
    named: dict[str, Callable[[], Iterable[str]]] = {
        "protocol": _protocol_names, "overrides": lambda: BY_NAME, "effects": lambda: EFFECT_NAMES,
        "experiments": experiments, "signals": quantities,
    }
    return list(named[action.dest]()) if action.dest in named else []


def _protocol_names() -> Iterable[str]:
    from sma_bench.protocols import protocol_names

    return protocol_names()


def _reply(pattern: str, words: list[str], indent: int, then: str = "") -> str:
    reply = f'COMPREPLY=($(compgen -W "{" ".join(words)}" -- "$word"))'
    return f'{" " * indent}"{pattern}") {reply}{then} ;;'
