"""A bench without ROS for the dashboard's tests, and its server in a thread."""

import asyncio
import threading
from concurrent.futures import Future
from contextlib import contextmanager
from types import SimpleNamespace

from sma_bench.dashboard.live_state import CELSIUS_ZERO, COMMANDED, LiveState
from sma_bench.dashboard.server import DashboardServer

WIRES = ("front_1", "back_1")


def answered(answer):
    future = Future()
    if answer is not None:
        future.set_result(SimpleNamespace(success=answer[0], message=answer[1]))
    return future


class StandIn:
    """Wires at `volts`; a stop service and 0 V on the topic do what the test allows."""

    def __init__(self):
        self.state = LiveState()
        self.volts = dict.fromkeys(WIRES, 3.0)
        self.celsius = 80.0
        self.obeys = True
        self.stamp = lambda now: now
        """s of the source's clock"""
        self.on_read = lambda: None
        self.answers = {"serial_bridge": (True, "stopped")}
        self.zeros = self.stops = 0
        self.work = []

    def send_stop(self):
        self.stops += 1
        if self.obeys:
            self.volts = dict.fromkeys(self.volts, 0.0)
        return {node: answered(answer) for node, answer in self.answers.items()}

    def send_zero(self):
        self.zeros += 1
        return True

    def start_work(self, kind, records):
        self.work.append((kind, records))

    def read(self):
        """One reading of everything."""
        self.on_read()
        for wire, volts in self.volts.items():
            self.state.reading("voltage", wire, volts, stamp=self.stamp(self.state.clock()))
            self.state.reading("voltage", wire, volts, COMMANDED)
            self.state.reading("current", wire, volts / 2.7)
            self.state.reading("temperature", wire, self.celsius + CELSIUS_ZERO)

    @contextmanager
    def readings(self, period=0.02):
        """Readings in a thread, as long as the context lasts."""
        ended = threading.Event()

        def go_on():
            while not ended.wait(period):
                self.read()

        thread = threading.Thread(target=go_on)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


@contextmanager
def served(bench, host="127.0.0.1", title="/bench"):
    """The address of a page of the bench; the server runs in a thread."""
    ready = Future()

    async def serve():
        end = asyncio.Event()
        server = DashboardServer(bench, title, host, 0)
        ready.set_result((server.url, asyncio.get_running_loop(), end))
        await end.wait()
        await server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    url, loop, end = ready.result(30.0)
    try:
        yield url
    finally:
        loop.call_soon_threadsafe(end.set)
        thread.join()
