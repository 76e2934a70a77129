"""Every command in the README and in docs/ is one that the programs accept."""

import argparse
import itertools
import re
import shlex
from pathlib import Path

import click
import pytest

from examination.blind import command as blind
from examination.perf.perf import SECTIONS
from sma_bench.cli import COMMANDS, load_command
from sma_bench.errors import InputError
from sma_bench.nodes import bench_plan
from sma_bench.nodes.bench_plan import COMPOSITE, WIRE
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.protocols import protocol_names

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
EXPERIMENTS = [f"E{number}" for number in range(1, 13)]
HEADINGS = ("Purpose", "Wiring", "Command", "Result", "What can go wrong")
DEVELOPER = {"test", "blind", "perf", "check"}
FENCED = re.compile(r"^```[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`]+)`")
LAUNCH_ARGUMENTS = {
    "wire_bench.launch.py": WIRE.arguments,
    "composite_bench.launch.py": COMPOSITE.arguments,
    "replay.launch.py": bench_plan.ARGUMENTS,
}
PLACEHOLDERS = {"NODE": "simulator"}
# Within a sentence, without what they take.
NAMED_ONLY = {"call", "import", "info", "notebook", "python", "run"}


def commands(page: Path) -> list[str]:
    """Command lines of a page, whether in a block or within a sentence."""
    text = page.read_text()
    lines = [line for block in FENCED.findall(text) for line in block.splitlines()]
    lines += [" ".join(code.split()) for code in INLINE.findall(FENCED.sub("", text))]
    return [line.strip() for line in lines]


def documented(*programs: str) -> list[tuple[str, list[str]]]:
    found = []
    for page in PAGES:
        for line in commands(page):
            if line.startswith(tuple(f"{program} " for program in programs)):
                taken = itertools.takewhile(
                    lambda word: word not in (">", ">>"), shlex.split(line, comments=True)
                )
                words = [PLACEHOLDERS.get(w, w) for w in taken]
                found.append((f"{page.relative_to(ROOT)}: {line}", words[1:]))
    return found


def check_command(words: list[str]) -> str:
    """Why sma-bench would not take these words, or ""."""
    name, *rest = words
    if name == "perf":
        sections = {word for word in rest if word.replace("-", "").isalpha() and word[0] != "-"}
        return "" if sections <= set(SECTIONS) else f"no section among {sections}"
    if name == "blind":
        return objection(blind.parser(), rest) if len(rest) > 1 else ""
    if name in DEVELOPER:
        script = ROOT / "examination" / name / f"{(rest or [name])[0]}.py"
        return "" if name == "test" or script.is_file() else f"no {script}"
    if len(words) == 1 and name in NAMED_ONLY:
        return ""
    if name == "python":
        return "" if (ROOT / rest[0]).is_file() else f"no {rest[0]}"
    if name not in COMMANDS:
        return f"no command {name}"
    if name == "run":
        return "" if rest and rest[0] in NODE_TABLES else f"no node {rest[:1]}"
    try:
        load_command(name).make_context(name, rest)
    except (click.UsageError, InputError) as error:
        return str(error)
    return check_files(rest)


def objection(parser: argparse.ArgumentParser, words: list[str]) -> str:
    try:
        parser.parse_args(words)
    except (argparse.ArgumentError, InputError, SystemExit) as error:
        return str(error) or "not accepted"
    return ""


def check_files(words: list[str]) -> str:
    for word in words:
        if word.startswith("config/") and not (ROOT / word).is_file():
            return f"no file {word}"
    if "--protocol" in words and not is_protocol(words[words.index("--protocol") + 1]):
        return "no such protocol"
    return ""


def is_protocol(name: str) -> bool:
    """Whether it names a shipped protocol or a file of the reader's own."""
    return name in protocol_names() or name.endswith(".yaml")


def check_ros(words: list[str]) -> str:
    """Why ros2 would not know what these words name, or ""."""
    settings = dict(word.split(":=", 1) for word in words if ":=" in word)
    if not is_protocol(settings.get("protocol", protocol_names()[0])):
        return f"no protocol {settings['protocol']}"
    if words[:2] == ["run", "sma_bench"]:
        if words[2] == "sma-bench":
            return "" if words[3:] == ["--help"] else check_command(words[3:])
        return "" if words[2] in NODE_TABLES else f"no node {words[2]}"
    if words[:2] == ["launch", "sma_bench"]:
        launch = ROOT / "launch" / words[2]
        if not launch.is_file():
            return f"no {launch}"
        unknown = [name for name in settings if name not in LAUNCH_ARGUMENTS[words[2]]]
        return f"no launch argument {unknown}" if unknown else ""
    return ""


def test_the_pages_hold_commands_to_check():
    assert len(documented("./bench", "sma-bench")) > 40
    assert len(documented("ros2")) > 12


@pytest.mark.parametrize(
    ("where", "words"), [pytest.param(*c, id=c[0]) for c in documented("./bench", "sma-bench")]
)
def test_documented_command_is_accepted(where, words):
    assert check_command(words) == ""


@pytest.mark.parametrize(
    ("where", "words"), [pytest.param(*c, id=c[0]) for c in documented("ros2")]
)
def test_documented_ros_command_names_what_exists(where, words):
    assert check_ros(words) == ""


@pytest.mark.parametrize(
    "line",
    ["identfy x", "identify", "identify x --outt y", "run simulatr", "check nothing",
     "simulate --protocol stairs --out x", "audit config/none.yaml", "paper staircase"],
)
def test_a_command_that_does_not_exist_is_found(line):
    assert check_command(line.split()) != ""


def test_a_ros_command_that_does_not_exist_is_found():
    for line in ("run sma_bench simulatr", "launch sma_bench none.launch.py",
                 "launch sma_bench wire_bench.launch.py protcol:=ramp",
                 "run sma_bench experiment -p protocol:=stairs"):
        assert check_ros(line.split()) != "", line


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_a_page_that_says_what_a_lab_must_know(name):
    text = (ROOT / "docs" / "experiments" / f"{name}.md").read_text()
    assert text.startswith(f"# {name} ")
    assert [heading for heading in HEADINGS if f"**{heading}.**" not in text] == []
    assert f"[{name}]({name}.md)" in (ROOT / "docs" / "experiments" / "README.md").read_text()
