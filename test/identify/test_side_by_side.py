"""Work side by side comes back whole and in order."""

import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from sma_bench.compiled import in_threads, threads_to_spare

pytestmark = pytest.mark.usefixtures("both_cores")


def test_two_threads_give_results_in_order_and_what_they_call_runs_in_them():
    both = threading.Barrier(2)

    def outer(k):
        if k < 2:
            both.wait(60.0)
        inner = in_threads(lambda j: (k, j, threading.get_ident()), [(j,) for j in range(3)])
        return inner, threading.get_ident(), threads_to_spare()

    found = in_threads(outer, [(k,) for k in range(12)])
    assert len({thread for _, thread, _ in found}) == 2
    for k, (inner, thread, spare) in enumerate(found):
        assert inner == [(k, j, thread) for j in range(3)] and spare == 0
    with pytest.raises(ZeroDivisionError):  # the first error is raised
        in_threads(lambda k: 1 / k, [(2,), (1,), (0,)])
    assert in_threads(lambda k: threads_to_spare(), [(0,)]) == [2]


def test_a_process_of_a_pool_and_one_that_is_told_so_keep_to_one_core(monkeypatch):
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        assert pool.submit(threads_to_spare).result() == 0
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    assert threads_to_spare() == 0
