"""Work side by side comes back whole and in order, whatever becomes of the process beside."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.estimation import side_by_side
from sma_bench.estimation.side_by_side import in_processes, in_threads

pytestmark = pytest.mark.usefixtures("both_cores")

NUMBERS = [(k,) for k in range(12)]
HERE = os.getpid()


@dataclass(eq=False)
class Answer:
    about: object
    where: int
    values: np.ndarray


@pytest.fixture
def forking(monkeypatch):
    """As in a process of one thread, whatever libraries the tests have loaded."""
    monkeypatch.setattr(side_by_side, "_may_fork", lambda: True)


def slowly(k):
    time.sleep(0.02)
    return k**2, os.getpid()


def together(work):
    """`work` whose first call in each of two processes waits for that in the other, however late
    a busy machine lets it begin."""
    both, waited = get_context("fork").Barrier(2), set()

    def one(k):
        if os.getpid() not in waited:
            waited.add(os.getpid())
            both.wait(60.0)
        return work(k)

    return one


@pytest.mark.parametrize("side_by", [in_threads, in_processes])
def test_results_come_in_the_order_of_the_arguments(side_by, forking):
    assert [square for square, _ in side_by(slowly, NUMBERS)] == [k**2 for (k,) in NUMBERS]


def test_a_thread_does_what_its_calls_call_in_their_turn():
    def inner(k):
        return in_threads(lambda j: (k, j, threading.get_ident()), [(j,) for j in range(3)])

    both = threading.Barrier(2)

    def outer(k):
        if k < 2:
            both.wait(60.0)
        time.sleep(0.02 * (k == 0))  # the first ends last
        return k, threading.get_ident(), inner(k)

    found = in_threads(outer, [(k,) for k in range(6)])
    assert [k for k, _, _ in found] == list(range(6))
    assert len({thread for _, thread, _ in found} - {threading.get_ident()}) == 2
    for k, thread, below in found:
        assert below == [(k, j, thread) for j in range(3)]


def test_an_error_in_a_thread_is_that_of_the_call():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda k: 1 / k, [(2,), (1,), (0,)])


def test_a_copy_of_this_process_does_its_part(forking):
    where = {number for _, number in in_processes(together(slowly), NUMBERS)}
    assert HERE in where and len(where) == 2


def test_what_is_large_and_here_as_well_is_not_handed_over(forking):
    record = threading.Lock()  # which could not be

    def answer(k):
        return Answer(record, os.getpid(), np.full(3, float(k)))

    answers = in_processes(
        together(answer), NUMBERS,
        lambda a: (a.where, a.values), lambda sent: Answer(record, *sent),
    )  # fmt: skip
    assert any(a.where != HERE for a in answers)
    assert all(a.about is record for a in answers)
    assert [a.values[0] for a in answers] == [float(k) for (k,) in NUMBERS]


def test_an_error_is_raised_here_as_it_was_there(forking):
    def refuse(k):
        time.sleep(0.02)
        if k == 7:
            raise InputError("seven: expected anything else")
        return k

    with pytest.raises(InputError, match="seven: expected anything else"):
        in_processes(refuse, NUMBERS)


def test_what_a_killed_copy_had_taken_is_done_here(forking):
    def work(k):
        time.sleep(0.02)
        if os.getpid() != HERE:
            os.kill(os.getpid(), signal.SIGKILL)
        return k

    assert in_processes(work, NUMBERS) == [k for (k,) in NUMBERS]


def test_what_a_copy_that_does_not_answer_had_taken_is_done_here(forking, monkeypatch):
    monkeypatch.setattr(side_by_side, "_PATIENCE", 0.2)

    def work(k):
        time.sleep(0.02 if os.getpid() == HERE else 600.0)
        return k

    assert in_processes(work, NUMBERS) == [k for (k,) in NUMBERS]


def test_what_a_copy_killed_amid_its_answer_had_done_is_done_here(forking, monkeypatch):
    def half(work, deliver, parent):
        work()
        os.write(deliver.fileno(), b"\0\0\1\0half")  # of 256 bytes
        os._exit(0)

    monkeypatch.setattr(side_by_side, "_deliver", half)
    assert [square for square, _ in in_processes(slowly, NUMBERS)] == [k**2 for (k,) in NUMBERS]


def test_where_no_process_can_be_made_all_is_done_here(forking, monkeypatch):
    def refused():
        raise BlockingIOError("too many processes")

    monkeypatch.setattr(os, "fork", refused)
    assert {number for _, number in in_processes(slowly, NUMBERS)} == {HERE}


def test_an_interrupt_ends_the_work_and_the_copy(forking):
    before, others = signal.pthread_sigmask(signal.SIG_BLOCK, ()), set(children())
    copies = []

    def interrupted(k):
        time.sleep(0.2)
        if os.getpid() == HERE:
            copies.extend(set(children()) - others)
            signal.raise_signal(signal.SIGINT)
        return k

    with pytest.raises(KeyboardInterrupt):
        in_processes(interrupted, NUMBERS)
    assert copies and not any(_lives(copy) for copy in copies)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


def children():
    return [
        int(name) for name in os.listdir("/proc") if name.isdigit() and _parent(name) == HERE
    ]


def test_inside_side_by_side_work_there_is_no_more_of_it(forking):
    def outer(k):
        time.sleep(0.02)
        inner = {number for _, number in in_processes(slowly, NUMBERS[:3])}
        return inner == {os.getpid()}

    assert all(in_processes(outer, NUMBERS[:4]))


def test_beside_threads_that_python_does_not_know_nothing_is_forked(monkeypatch):
    monkeypatch.setattr(threading, "active_count", lambda: 0)
    assert {number for _, number in in_processes(slowly, NUMBERS)} == {HERE}


def test_only_the_main_thread_forks():
    found = []
    work = threading.Thread(target=lambda: found.extend(in_processes(slowly, NUMBERS)))
    work.start()
    work.join()
    assert {number for _, number in found} == {HERE} and len(found) == len(NUMBERS)


def in_a_pool():
    return {number for _, number in in_processes(slowly, NUMBERS)} == {os.getpid()}


def test_a_process_of_a_pool_keeps_to_its_own_core():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(in_a_pool).result(timeout=60.0)


ENDLESS = """
import os, time
from sma_bench.estimation.side_by_side import in_processes

def forever(k):
    print(os.getpid(), flush=True) if os.getpid() == here else os.write(2, b"%d\\n" % os.getpid())
    time.sleep(60.0)

here = os.getpid()
in_processes(forever, [(1,), (2,)])
"""


def test_a_copy_ends_with_the_process_that_made_it():
    with subprocess.Popen(
        [sys.executable, "-c", ENDLESS], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    ) as process:  # fmt: skip
        assert process.stdout and process.stderr
        process.stdout.readline()
        copy = int(process.stderr.readline())
        process.kill()
    deadline = time.monotonic() + 30.0
    while _lives(copy):
        assert time.monotonic() < deadline, f"process {copy} still runs"
        time.sleep(0.05)


def _lives(number):
    return _state(number)[:1] not in ([], ["Z"])


def _parent(number):
    return int((_state(number) or [0, 0])[1])


def _state(number):
    """State, parent and more of a process; empty after its end."""
    try:
        with open(f"/proc/{number}/stat") as file:
            return file.read().rpartition(")")[2].split()
    except OSError:
        return []
