"""A disk that fills up: one line, what was written stays readable, good files stay good."""

import contextlib
import io
import os
import random
import resource
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from examination.campaign.outcome import Outcome
from sma_bench.cli import main as sma_bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_writer import BagWriter
from sma_bench.records.messages import streams_of

_SMALLEST, _LARGEST = 30_000, 600_000
_PER_FLUSH = 40
_MANY = 200_000


@contextlib.contextmanager
def small_disk(folder: Path, size: int) -> Iterator[str]:
    """`folder` with room for about `size` bytes, and what it is: a file system where this process
    may mount one, else a limit on the size of a file."""
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "sma_bench_full_disk", str(folder)]
    root = os.geteuid() == 0 and shutil.which("mount") is not None
    if root and subprocess.run(command, capture_output=True, check=False).returncode == 0:
        try:
            yield "tmpfs"
        finally:
            subprocess.run(["umount", "-l", str(folder)], check=True)
            folder.rmdir()
        return
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield "limit on files"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))
        shutil.rmtree(folder)


def full_disk(size: int, seed: int, folder: Path) -> list[Outcome]:
    """Fill `size` disks of random sizes with a bag, and as many with each command's files."""
    rng = random.Random(seed)
    bags, commands = [], []
    for number in range(size):
        with small_disk(folder / f"bag_{number}", rng.randrange(_SMALLEST, _LARGEST)) as disk:
            kind = disk
            bags.append(_fill_with_a_bag(folder / f"bag_{number}" / "bag"))
        for command in _COMMANDS:
            with small_disk(folder / f"out_{number}", rng.randrange(1, 4) * 4096):
                commands.append(_fill_with(command, folder / f"out_{number}"))
    return [
        Outcome.of("disk", f"{what} ({kind})", len(wrong), wrong)
        for what, wrong in (("recorder's bag fills the disk", bags),
                            (", ".join(_COMMANDS), commands))
    ]  # fmt: skip


def _fill_with_a_bag(path: Path) -> str:
    """What went wrong, or ""."""
    time = np.arange(_MANY) * 0.01
    noise = np.random.default_rng(0).normal(300.0, 10.0, _MANY)
    signal = Signal("wire.temperature", "K", time, noise)
    (stream,) = streams_of({signal.name: signal}, "/bench/", 10**18)
    safe = 0
    try:
        bag = BagWriter(path, flush_every=float("inf"))
        bag.add_topic(stream.topic, stream.type)
        for number, (stamp, blob) in enumerate(zip(stream.received, stream.blobs, strict=True)):
            bag.write(stream.topic, int(stamp), blob)
            if number % _PER_FLUSH == _PER_FLUSH - 1:
                bag.flush()
                safe = number + 1
    except InputError as error:
        if "\n" in str(error) or "cannot be written" not in str(error):
            return f"says {error!s:.80}"
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {error}"
    else:
        return "the disk never filled"
    finally:
        with contextlib.suppress(InputError, UnboundLocalError):
            bag.close()
    try:
        found = read_record(path)["wire.temperature"].values
    except InputError as error:
        return f"{safe} messages were flushed, but: {error}" if safe else ""
    if len(found) < safe or (np.abs(found[:safe] - noise[:safe]) > 1e-9).any():
        return f"{safe} messages were flushed, {len(found)} are read"
    return ""


# Commands that write more than these disks hold; `good` is a good file on them.
_COMMANDS = {
    "simulate": ["simulate", "--params", "{params}", "--protocol", "quick_ramp", "--out",
                 "{disk}/bag"],
    "simulate --json": ["simulate", "--protocol", "quick_ramp", "--out", "{beside}/bag", "--json",
                        "{disk}/good", "--force"],
    "parameters": ["parameters", "--params", "{params}", "--out", "{disk}/good", "--force"],
}  # fmt: skip


def _fill_with(command: str, disk: Path) -> str:
    """What went wrong, or "": a command's file or bag on a full disk, over a good file."""
    (disk / "good").write_text("good")
    # Take what room the disk has left; with a limit on files there is no need.
    with (disk / "ballast").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        for _ in range(1000):
            file.write(bytes(4096))
    beside = disk.parent / f"{disk.name}_beside"
    shutil.rmtree(beside, ignore_errors=True)
    beside.mkdir()
    write_parameters(beside / "params.yaml", Parameters.defaults())
    names = {"params": beside / "params.yaml", "beside": beside, "disk": disk}
    said = io.StringIO()
    arguments = [part.format(**names) for part in _COMMANDS[command]]
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            status = sma_bench(arguments)
        except Exception as error:  # that is what is looked for
            return f"{command}: {type(error).__name__}: {error}"
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            if f"/{disk.name}/" in os.readlink(link):
                return f"{command}: leaves a file open"
    # What takes its time says how far it is.
    lines = [line for line in said.getvalue().splitlines() if "cannot" in line or "Error" in line]
    if status != 2 or len(lines) != 1:
        return f"{command}: status {status}, says {said.getvalue()[-200:]!r}"
    if (disk / "good").read_text() != "good":
        return f"{command}: the good file is damaged"
    left = sorted(p.name for p in disk.iterdir() if p.name not in ("good", "ballast", "bag"))
    return f"{command}: leaves {', '.join(left)}" if left else ""
