"""Months of one conversation: answers go to whoever asked, and to nobody else."""

import tracemalloc

from sma_bench.hardware.conversation import Conversation
from sma_bench.hardware.serial_messages import line

COUNTERS = " ".join(f"counter{k}={10_000 + k}" for k in range(8))


class CountingDevice:
    """Sends its counters whenever it is read, and consents to what it is asked."""

    timeout = 0.0
    in_waiting = 1

    def __init__(self):
        self.answers = []

    def read(self, size=1):
        return self.answers.pop(0) if self.answers else line(f"S {COUNTERS}")

    def write(self, data):
        self.answers = [line(f"S {COUNTERS}"), line("K R 1")]


def test_counters_that_nobody_asked_for_are_not_kept():
    conversation = Conversation(CountingDevice())

    def held_after(seconds):
        for _ in range(seconds):
            messages, _ = conversation.receive()
            assert len(messages) == 1
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = held_after(100)
        a_second = (held_after(1000) - before) / 1000
    finally:
        tracemalloc.stop()
    assert a_second < 10.0


def test_an_answer_is_found_among_counters():
    conversation = Conversation(CountingDevice())
    conversation.receive()
    found = conversation.ask("R", complete=lambda answers: len(answers) == 2, pump=True)
    assert [answer.letter for answer in found] == ["S", "R"]
    assert conversation.unasked == ""
