"""Every command in the README and in docs/ is one that the programs accept."""

import itertools
import re
import shlex
from pathlib import Path

import click

from examination.blind.command import blind
from examination.perf.perf import SECTIONS
from sma_bench.cli import load_command
from sma_bench.errors import InputError
from sma_bench.nodes import bench_plan
from sma_bench.nodes.bench_plan import COMPOSITE, WIRE
from sma_bench.nodes.start import CONTAINER
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.protocols import protocol_names

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCED = re.compile(r"^```[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`([^`]+)`")
LAUNCH_ARGUMENTS = {"wire_bench.launch.py": WIRE.arguments,
                    "composite_bench.launch.py": COMPOSITE.arguments,
                    "replay.launch.py": bench_plan.REPLAY}  # fmt: skip
# Commands that may be named in a sentence without arguments.
NAMED_ONLY = {"call", "import", "info", "notebook", "python", "run"}


def documented(*programs):
    """Command lines of the pages, in a block or a sentence: (place, words)."""
    found = []
    for page in PAGES:
        text = page.read_text()
        lines = [line.strip() for block in FENCED.findall(text) for line in block.splitlines()]
        lines += [" ".join(code.split()) for code in INLINE.findall(FENCED.sub("", text))]
        for line in lines:
            if line.startswith(tuple(f"{program} " for program in programs)):
                words = shlex.split(line, comments=True)
                taken = itertools.takewhile(lambda word: word not in (">", ">>"), words)
                shown = ["simulator" if word == "NODE" else word for word in taken]
                found.append((f"{page.relative_to(ROOT)}: {line}", shown[1:]))
    return found


OURS, ROS = documented("./bench", "sma-bench"), documented("ros2")


def is_protocol(name):
    """True if it is a protocol of the package or a file of the reader."""
    return name in protocol_names() or name.endswith(".yaml")


def check_command(words):
    """Why ./bench or sma-bench would refuse these words, or ""."""
    name, *rest = words
    if name == "test" or (len(words) == 1 and name in NAMED_ONLY):
        return ""
    if name == "perf":
        sections = {word for word in rest if word.replace("-", "").isalpha() and word[0] != "-"}
        return "" if sections <= set(SECTIONS) else f"no section among {sections}"
    if name == "check":
        script = ROOT / "examination" / "check" / f"{rest[0]}.py"
        return "" if script.is_file() else f"no {script}"
    if name == "python":
        return "" if (ROOT / rest[0]).is_file() else f"no {rest[0]}"
    if name == "run":
        return "" if rest and rest[0] in NODE_TABLES else f"no node {rest[:1]}"
    if name == "blind" and len(rest) < 2:
        return ""
    try:
        if name == "blind":
            blind.commands[rest[0]].make_context(rest[0], rest[1:])
        else:
            load_command(name).make_context(name, rest)
    except (KeyError, click.UsageError, InputError) as error:
        return str(error)
    for word in rest:
        if word.startswith("config/") and not (ROOT / word).is_file():
            return f"no file {word}"
    if "--protocol" in rest and not is_protocol(rest[rest.index("--protocol") + 1]):
        return "no such protocol"
    return ""


def check_ros(words):
    """Why ros2 would not find the names in these words, or ""."""
    settings = dict(word.split(":=", 1) for word in words if ":=" in word)
    if not is_protocol(settings.get("protocol", protocol_names()[0])):
        return f"no protocol {settings['protocol']}"
    if words[:2] == ["run", "sma_bench"]:
        if words[2] == "sma-bench":
            return "" if words[3:] == ["--help"] else check_command(words[3:])
        return "" if words[2 + (words[2] == CONTAINER)] in NODE_TABLES else f"no node {words[2]}"
    if words[:2] == ["launch", "sma_bench"]:
        if not (ROOT / "launch" / words[2]).is_file():
            return f"no {words[2]}"
        unknown = [name for name in settings if name not in LAUNCH_ARGUMENTS[words[2]]]
        return f"no launch argument {unknown}" if unknown else ""
    return ""


def test_every_documented_command_is_accepted_and_names_what_exists():
    assert len(OURS) > 40 and len(ROS) > 12
    for lines, check in ((OURS, check_command), (ROS, check_ros)):
        assert {where: why for where, words in lines if (why := check(words))} == {}
