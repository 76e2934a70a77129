"""Processes that end when they are asked to, and with the one that started them, even where that is
killed outright: it cannot end those it has started, they have to notice by themselves."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator

_VARIABLE = "SMA_BENCH_STARTED_BY"
_LOOK = 0.1  # s


def ending_signals() -> list[signal.Signals]:
    """What asks a node to end; not the end of its terminal where it is started with nohup."""
    unheard = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM] + ([] if unheard else [signal.SIGHUP])


def tied_to_this_process() -> dict[str, str]:
    """Environment of a process that is to end with this one."""
    return {**os.environ, _VARIABLE: str(os.getpid())}


def end_with_parent(number: int = signal.SIGTERM, inherited: bool = False) -> None:
    """Where the environment ties this process to its parent, get signal `number` once that has
    ended. `inherited`: a program in between may have passed it on, which ties nothing."""
    parent = os.environ.pop(_VARIABLE, "")
    if parent and not (inherited and parent != str(os.getppid())):
        end_after(int(parent), number)


def end_with_starter(number: int = signal.SIGTERM) -> None:
    """As `end_with_parent`, and where nothing ties this process but that it belongs to the process
    group of another one: `ros2 launch`, `ros2 run` or a script has started it. A shell's own job, a
    service and what `setsid` starts lead a group of their own and live by themselves."""
    if _VARIABLE in os.environ:
        end_with_parent(number)
    elif os.getpgrp() != os.getpid():
        starter, parent = -1, os.getppid()
        with contextlib.suppress(OSError):  # it was gone before it could be asked for
            starter = parent if os.getsid(parent) == os.getsid(0) else -1
        end_after(starter, number)


def end_after(parent: int, number: int = signal.SIGTERM) -> None:
    """Get signal `number` after the process `parent`, which has started this one, has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        with contextlib.suppress(OSError):  # nobody may be left to read it
            os.write(2, f"ends with process {parent}, which had started it\n".encode())
        os.kill(os.getpid(), number)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C and a polite kill wait until the end, and a process that is started meanwhile never
    hears of Ctrl-C, which reaches the whole group and is for the parent to act upon."""
    arrived, handlers = list[int](), {}
    if threading.current_thread() is threading.main_thread():  # no other is ever interrupted
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, lambda number, _: arrived.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for held in arrived:
            signal.raise_signal(held)
