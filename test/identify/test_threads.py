"""Simulations side by side, which the tests of a worker otherwise do one after the other."""

import threading
from time import sleep

import pytest

from sma_bench.estimation.threads import in_threads


@pytest.mark.usefixtures("threads_of_a_fit")
def test_results_come_in_the_order_of_the_arguments_and_each_is_of_one_thread():
    def inner(k):
        return in_threads(lambda j: (k, j, threading.get_ident()), [(j,) for j in range(3)])

    def outer(k):
        sleep(0.02 * (k == 0))  # the first ends last
        return k, threading.get_ident(), inner(k)

    found = in_threads(outer, [(k,) for k in range(6)])
    assert [k for k, _, _ in found] == list(range(6))
    assert len({thread for _, thread, _ in found} - {threading.get_ident()}) == 2
    for k, thread, below in found:
        assert below == [(k, j, thread) for j in range(3)]


@pytest.mark.usefixtures("threads_of_a_fit")
def test_an_error_in_a_thread_is_that_of_the_call():
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda k: 1 / k, [(2,), (1,), (0,)])
