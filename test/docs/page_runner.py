"""Runs the commands of a documentation page in an empty folder, in the page's order.

Nothing is there but `sma-bench` and what the page itself gives.

Fenced blocks are told by their language: none, `bash` or `console` holds commands, `python` is run,
all others are shown only. A comment right before a block says what the block needs:

    <!-- file: NAME -->            the reader writes the block into this file
    <!-- shown: NAME -->           the block is the text of a file that `sma-bench example` gave
    <!-- not run: REASON -->       the block cannot be run in a test

Commands of ROS 2 and nodes that run until they are stopped are never run here: their names and
arguments are checked by test_documented_commands.py, the nodes by tests of their own.
"""

import contextlib
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sma_bench.cli import main

ROOT = Path(__file__).resolve().parents[2]
SHOWN_TO_A_SHELL = ("", "bash", "console")
NEEDS_ROS = ("ros2", "colcon", "source")
PROGRAMS = ("sma-bench", "./bench")
_BLOCK = re.compile(
    r"(?P<notes>(?:^<!-- [^\n]* -->\n+)*)^```(?P<kind>\w*)\n(?P<text>.*?)^```", re.M | re.S
)
_NOTE = re.compile(r"<!-- (file|shown|not run): (.*?) -->")
_SHELL = re.compile(r"[|<>;&$`*~]")
# Output into a file, which needs no shell either.
_WRITTEN = re.compile(r"(?P<command>[^|<>;&$`*~]+) >(?P<more>>?) (?P<file>~?[\w./-]+)")
_BENCH = '#!/bin/sh\nexec "{python}" -P -m sma_bench.cli "$@"\n'


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, text, and what the comments before it say."""

    kind: str
    text: str
    file: str | None = None
    shown: str | None = None
    not_run: str | None = None

    @property
    def commands(self) -> list[str]:
        """Its command lines, those that go on in the next line joined, without comments."""
        if self.kind not in SHOWN_TO_A_SHELL:
            return []
        lines = self.text.replace("\\\n", " ").splitlines()
        lines = [line.removeprefix("$ ") for line in lines]
        told = [shlex.join(shlex.split(line, comments=True)) and line for line in lines]
        return [line.partition("  #")[0].strip() for line in told if line]


def blocks_of(page: Path) -> Iterator[Block]:
    """All fenced blocks of a page."""
    for found in _BLOCK.finditer(page.read_text()):
        told = dict(_NOTE.findall(found["notes"]))
        yield Block(found["kind"], found["text"], *map(told.get, ("file", "shown", "not run")))


def is_command(line: str) -> bool:
    """Whether a line of a block without a language is one for a shell: drawings are not."""
    return line.split()[0] in (*PROGRAMS, *NEEDS_ROS, "cd", "git", "mkdir", "pip", "python")


def runs_in_a_test(line: str) -> bool:
    """Whether a command ends by itself, without ROS 2."""
    words = line.split()
    return words[0] not in NEEDS_ROS and not (words[0] in PROGRAMS and words[1:2] == ["run"])


class PageRunner:
    """The reader's terminal, in the folder that is current.

    Args:
        home: the reader's home, where the command is installed too.
    """

    def __init__(self, home: Path) -> None:
        program = home / ".bin" / "sma-bench"
        program.parent.mkdir(parents=True)
        program.write_text(_BENCH.format(python=sys.executable))
        program.chmod(0o755)
        self._shell = dict(os.environ, HOME=str(home))
        self._shell["PATH"] = f"{program.parent}:{self._shell['PATH']}"
        self._names: dict[str, object] = {"__name__": "__main__"}

    def play(self, page: Path) -> int:
        """Run a page; the number of commands that were run.

        Raises:
            AssertionError: one ended with another exit code than 0; it is named.
        """
        count = 0
        for block in blocks_of(page):
            if block.not_run:
                continue
            if block.shown:
                assert Path(block.shown).read_text() == block.text, f"{page.name}: {block.shown}"
            if block.file:
                Path(block.file).write_text(block.text)
            elif block.kind == "python":
                exec(compile(block.text, f"{page.name}: python", "exec"), self._names)
                count += 1
            for command in [] if block.file else block.commands:
                if is_command(command) and runs_in_a_test(command):
                    self.run(command)
                    count += 1
        return count

    def run(self, command: str) -> None:
        """One command: those of sma-bench in this process, which spares seconds each."""
        words = shlex.split(command)
        if words[0] == "cd" and not _SHELL.search(command):
            os.chdir(words[1])
        elif words[0] in PROGRAMS and not _SHELL.search(command):
            assert main(words[1:]) == 0, command
        elif words[0] in PROGRAMS and (written := _WRITTEN.fullmatch(command)):
            place = Path(written["file"].replace("~", self._shell["HOME"], 1))
            mode = "a" if written["more"] else "w"
            with place.open(mode) as file, contextlib.redirect_stdout(file):
                assert main(shlex.split(written["command"])[1:]) == 0, command
        else:
            shell = ["bash", "-eo", "pipefail", "-c", command]
            done = subprocess.run(shell, env=self._shell, text=True, capture_output=True)
            assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
