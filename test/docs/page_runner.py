"""Runs the commands of a documentation page in an empty folder, in the page's order.

Nothing is there but `sma-bench` and what the page itself gives. Fenced blocks without a language
hold commands, `python` is run, all others are shown only. A comment right before a block says what
it needs:

    <!-- file: NAME -->            the reader writes the block into this file
    <!-- shown: NAME -->           the block is the text of a file that `sma-bench example` gave
    <!-- not run: REASON -->       the block cannot be run in a test

Commands of ROS 2 and nodes that run until they are stopped are never run here: their names and
arguments are checked by test_documented_commands.py, the nodes by tests of their own.
"""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from sma_bench.cli import main

PROGRAMS = ("sma-bench", "./bench")
# First words of commands; drawings in blocks without a language have others.
COMMANDS = (*PROGRAMS, "cd", "git", "mkdir", "pip", "python")
_BLOCK = re.compile(
    r"(?P<notes>(?:^<!-- [^\n]* -->\n+)*)^```(?P<kind>\w*)\n(?P<text>.*?)^```", re.M | re.S
)
_NOTE = re.compile(r"<!-- (file|shown|not run): (.*?) -->")
_SHELL = re.compile(r"[|<>;&$`*~]")
_BENCH = '#!/bin/sh\nexec "{python}" -P -m sma_bench.cli "$@"\n'


class Block(NamedTuple):
    """A fenced block: its language, text, and what the comments before it say."""

    kind: str
    text: str
    file: str | None = None
    shown: str | None = None
    not_run: str | None = None

    @property
    def commands(self):
        """Those that end by themselves, without ROS 2; those that go on in the next line joined."""
        if self.kind not in ("", "bash", "console") or self.file or self.not_run:
            return []
        found = []
        for line in self.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line := line.removeprefix("$ "), comments=True)
            if words and words[0] in COMMANDS and words[1:2] != ["run"]:
                found.append(line.partition("  #")[0].strip())
        return found

    @property
    def runs(self):
        return not self.not_run and bool(self.kind == "python" or self.commands or self.file)


def blocks_of(page):
    """All fenced blocks of a page."""
    for found in _BLOCK.finditer(page.read_text()):
        notes = dict(_NOTE.findall(found["notes"]))
        yield Block(found["kind"], found["text"], *map(notes.get, ("file", "shown", "not run")))


def play(page, home):
    """Run a page in the current folder by a reader with this home, where the command is installed;
    the number of commands. AssertionError: one ended with another exit code than 0; it is named."""
    program = home / ".bin" / "sma-bench"
    program.parent.mkdir(parents=True)
    program.write_text(_BENCH.format(python=sys.executable))
    program.chmod(0o755)
    path = f"{program.parent}:{os.environ['PATH']}"
    names, count = {"__name__": "__main__"}, 0
    for block in blocks_of(page):
        if block.not_run:
            continue
        if block.shown:
            assert Path(block.shown).read_text() == block.text, f"{page.name}: {block.shown}"
        if block.file:
            Path(block.file).write_text(block.text)
        elif block.kind == "python":
            exec(compile(block.text, f"{page.name}: python", "exec"), names)
            count += 1
        for command in block.commands:
            run(command, dict(os.environ, HOME=str(home), PATH=path))
            count += 1
    return count


def run(command, environment):
    """One command: those of sma-bench in this process, which spares seconds each."""
    words, is_plain = shlex.split(command), not _SHELL.search(command)
    if words[0] == "cd" and is_plain:
        os.chdir(words[1])
    elif words[0] in PROGRAMS and is_plain:
        assert main(words[1:]) == 0, command
    else:
        shell = ["bash", "-eo", "pipefail", "-c", command]
        done = subprocess.run(shell, env=environment, text=True, capture_output=True)
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
