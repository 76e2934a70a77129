"""Ending processes: on signals, and together with the process that started them. After a SIGKILL,
that one cannot end its children; they must notice by themselves."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator

_VARIABLE = "SMA_BENCH_STARTED_BY"
_LOOK = 0.1  # s between checks that the parent lives


def ending_signals() -> list[signal.Signals]:
    """Signals that end a node; SIGHUP not if it is ignored (nohup)."""
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM] + ([] if ignored else [signal.SIGHUP])


def tied_to_this_process() -> dict[str, str]:
    """Environment for a child process that must end with this one."""
    return {**os.environ, _VARIABLE: str(os.getpid())}


def end_with_parent(number: int = signal.SIGTERM, inherited: bool = False) -> None:
    """If the environment ties this process to its parent, send it signal `number` once the parent
    has ended. `inherited`: ignore a variable that was passed on from another process."""
    parent = os.environ.pop(_VARIABLE, "")
    if parent and not (inherited and parent != str(os.getppid())):
        end_after(int(parent), number)


def end_with_starter(number: int = signal.SIGTERM) -> None:
    """As `end_with_parent`; also if this process is in the process group of another one, so started
    by `ros2 launch`, `ros2 run` or a script. A job of an interactive shell, a service and a process
    started by `setsid` lead their own group and do not end with their parent."""
    if _VARIABLE in os.environ:
        end_with_parent(number)
    elif os.getpgrp() != os.getpid():
        starter, parent = -1, os.getppid()
        with contextlib.suppress(OSError):  # the parent has ended already
            starter = parent if os.getsid(parent) == os.getsid(0) else -1
        end_after(starter, number)


def end_after(parent: int, number: int = signal.SIGTERM) -> None:
    """Send this process signal `number` once its parent process `parent` has ended."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        with contextlib.suppress(OSError):  # standard error may be closed
            os.write(2, f"ending: process {parent}, which started this one, has ended\n".encode())
        os.kill(os.getpid(), number)

    threading.Thread(target=watch, name="lifeline", daemon=True).start()


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Delay SIGINT and SIGTERM until the end. Processes started inside keep SIGINT blocked: Ctrl-C
    reaches the whole group, and the parent handles it."""
    arrived, handlers = list[int](), {}
    if threading.current_thread() is threading.main_thread():  # only this thread gets signals
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
