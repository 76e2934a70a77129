"""Results of parallel work are complete and in order."""

import threading
import time

import joblib
import pytest

from sma_bench.compiled import in_threads, threads_to_spare

pytestmark = pytest.mark.usefixtures("both_cores")


def test_two_threads_give_results_in_order_and_the_first_error():
    both = threading.Barrier(2)

    def outer(k):
        if k < 2:
            both.wait(60.0)
        inner = in_threads(lambda j: (k, j), [(j,) for j in range(3)])
        return inner, threading.get_ident()

    found = in_threads(outer, [(k,) for k in range(12)])
    assert len({thread for _, thread in found}) == 2
    assert [inner for inner, _ in found] == [[(k, j) for j in range(3)] for k in range(12)]
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda k: 1 / k, [(2,), (1,), (0,)])
    assert in_threads(lambda k: threads_to_spare(), [(0,), (1,)]) == [2, 2]


def test_an_idle_thread_helps_with_parts_of_the_others_task():
    """Once a short task is done, parts of the long one run two at a time, never three."""
    running, most = set(), []

    def part(_):
        running.add(threading.get_ident())
        time.sleep(0.01)
        most.append(len(running))
        running.discard(threading.get_ident())
        return threading.get_ident()

    def task(long):
        end, threads = time.monotonic() + 60.0, set()
        while long and len(threads) < 2 and time.monotonic() < end:
            threads = set(in_threads(part, [(0,), (1,)]))
        return threads

    for order in ((True, False), (False, True)):
        assert len(in_threads(task, [(long,) for long in order])[order.index(True)]) == 2
    assert max(most) == 2


def test_a_pool_process_and_one_limited_by_the_environment_use_one_core(monkeypatch):
    processes = max(joblib.cpu_count(), 2)
    asked = [joblib.delayed(threads_to_spare)()] * processes
    assert set(joblib.Parallel(processes)(asked)) == {0}
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert threads_to_spare() == 0
