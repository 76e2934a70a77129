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

from examination.pieces import Outcome
from sma_bench.cli import main as sma_bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_writer import BagWriter, streams_of

_SMALLEST, _LARGEST = 30_000, 600_000  # bytes
_MANY, _PER_FLUSH = 200_000, 40  # messages


@contextlib.contextmanager
def small_disk(folder: Path, size: int) -> Iterator[str]:
    """`folder` with room for `size` bytes; whether a file system or a limit on files."""
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
    rng, bags, commands = random.Random(seed), [], []
    for number in range(size):
        with small_disk(folder / f"bag_{number}", rng.randrange(_SMALLEST, _LARGEST)) as kind:
            bags.append(_fill_with_a_bag(folder / f"bag_{number}" / "bag"))
        for command in _COMMANDS:
            with small_disk(folder / f"out_{number}", rng.randrange(1, 4) * 4096):
                found = _fill_with(command, folder / f"out_{number}")
                commands.append(f"{command}: {found}" if found else "")
    return [
        Outcome.of("disk", f"{what} ({kind})", len(wrong), wrong)
        for what, wrong in (("recorder's bag fills the disk", bags),
                            (", ".join(_COMMANDS), commands))  # fmt: skip
    ]


def _fill_with_a_bag(path: Path) -> str:
    """What went wrong, or ""."""
    noise = np.random.default_rng(0).normal(300.0, 10.0, _MANY)
    signal = Signal("wire.temperature", "K", np.arange(_MANY) * 0.01, noise)
    (stream,) = streams_of({signal.name: signal}, "/bench/", 10**18)
    safe = 0
    try:
        bag = BagWriter(path, flush_every=float("inf"))
        bag.add_topic(stream.topic, stream.type)
        for number, (stamp, blob) in enumerate(zip(stream.received, stream.blobs, strict=True), 1):
            bag.write(stream.topic, int(stamp), blob)
            if number % _PER_FLUSH == 0:
                bag.flush()
                safe = number
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
_COMMANDS = {"simulate": "--params {params} --protocol quick_ramp --out {disk}/bag",
             "simulate --json": "{disk}/good --protocol quick_ramp --out {beside}/bag --force",
             "parameters": "--params {params} --out {disk}/good --force"}  # fmt: skip


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
    params, said = beside / "params.yaml", io.StringIO()
    write_parameters(params, Parameters.defaults())
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            rest = _COMMANDS[command].split()
            words = [word.format(params=params, beside=beside, disk=disk) for word in rest]
            status = sma_bench([*command.split(), *words])
        except Exception as error:  # that is what is looked for
            return f"{type(error).__name__}: {error}"
    # What takes its time says how far it is.
    lines = [line for line in said.getvalue().splitlines() if "cannot" in line or "Error" in line]
    if status != 2 or len(lines) != 1:
        return f"status {status}, says {said.getvalue()[-200:]!r}"
    if (disk / "good").read_text() != "good":
        return "the good file is damaged"
    left = sorted(p.name for p in disk.iterdir() if p.name not in ("good", "ballast", "bag"))
    return f"leaves {', '.join(left)}" if left else ""
