"""Records, diagnoses, proposes and has the experiment node run, until the cause is named: what
`sma-bench investigate` does, as services of a node."""

import json
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import SetParameters
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.nodes.base import BenchNode
from sma_bench.parameters import Parameters
from sma_bench.ros.bench_client import NodeCalls
from sma_bench.ros.node import LATCHED
from sma_bench.tasks.jobs import Worker, investigate, investigation_folder, output_inside

_WAITING, _RUNNING, _STOPPED, _FAILED = "waiting for confirmation", "running", "stopped", "failed"
_LOOK_EVERY = 0.05
_LAST_RUN = 10.0  # s that a run may take to end with its node


class InvestigationNode(BenchNode):
    """Investigates the gap between bench and model: set `folder` (and `record`), call `~/start`;
    `~/confirm` runs what is proposed, `~/stop` ends whatever goes on, at 0 V. `~/start` goes on
    from what the folder holds.

    Latched: `~/state` (idle, diagnosing, waiting for confirmation: PROTOCOL, running: PROTOCOL,
    named: CAUSE, inseparable, budget spent, a test is needed, stopped, failed: why) and `~/result`
    (the story as JSON, what is proposed under `next`).

    The work has a thread of its own, its diagnoses a process of their own. A run is the experiment
    node's, under its rules.
    """

    with_uncertainty = True

    def __init__(self) -> None:
        super().__init__("investigation")
        self.check_settings(self.settings)
        self._stopping, self._confirmed = threading.Event(), threading.Event()
        self._work: threading.Thread | None = None
        self._worker = Worker("investigation")
        self._calls = NodeCalls(self, lambda: time.sleep(_LOOK_EVERY))
        for service in ("experiment/start", "experiment/stop"):
            self._calls.know(service)
        self._calls.know("experiment/set_parameters", SetParameters)
        for node in ("experiment", "recorder"):
            self._calls.follow(node)
        self._state = self.create_publisher(String, "~/state", LATCHED)
        self._result = self.create_publisher(String, "~/result", LATCHED)
        self.serve(start=self._on_start, confirm=self._on_confirm, stop=self._on_stop)
        self._tell("idle")

    def check_settings(self, settings: dict[str, Any]) -> None:
        output_inside(settings, "folder")

    def health(self) -> list[DiagnosticStatus]:
        failed = self._text.startswith(_FAILED)
        level = DiagnosticStatus.WARN if failed else DiagnosticStatus.OK
        return [self.status("investigation", level, self._text)]

    def drain(self, spin: Callable[[], None]) -> None:
        """Stop the bench while the experiment node's answer can still be heard."""
        self._stop()
        end = time.monotonic() + _LAST_RUN
        while self._busy() and time.monotonic() < end:
            spin()

    def close(self) -> None:
        self._stopping.set()
        self._worker.kill()

    # --- services -----------------------------------------------------------------------------

    def _on_start(self) -> str:
        if self._busy():
            raise InputError(f"busy: {self._text}")
        folder = investigation_folder(self.settings)
        self._stopping.clear()
        given = self.settings, self.parameters  # what is set from here on is for the next one
        self._work = threading.Thread(target=self._investigate, args=given, daemon=True)
        self._work.start()
        return f"in {folder}"

    def _on_confirm(self) -> str:
        if not self._text.startswith(_WAITING) or self._stopping.is_set():
            raise InputError(f"nothing to confirm: {self._text}")
        self._confirmed.set()
        return self._text

    def _on_stop(self) -> str:
        said = f"stopping, was {self._text}" if self._busy() else "nothing is running"
        self._stop()
        return said

    # --- the work -----------------------------------------------------------------------------

    def _busy(self) -> bool:
        return self._work is not None and self._work.is_alive()

    def _stop(self) -> None:
        self._stopping.set()
        if self._text.startswith(_RUNNING):  # at once; the thread then waits for the answer
            self._calls.know("experiment/stop").call_async(Trigger.Request())
        self._worker.cancel()

    def _investigate(self, *given: Any) -> None:
        try:
            self._tell(self._until_settled(*given))
        except InputError as error:
            if self._stopping.is_set():
                self._tell(_STOPPED)
                return
            self._tell(f"{_FAILED}: {error}")
            self.get_logger().error(str(error))

    def _until_settled(self, settings: Mapping[str, Any], parameters: Parameters) -> str:
        """How it ended."""
        while True:
            self._tell("diagnosing")
            self._heed()
            result = self._worker.run(investigate, settings, parameters, self._diagnosing)
            self._result.publish(String(data=result))
            story = json.loads(result)
            if (following := story["next"]) is None:
                return str(story["outcome"])
            self._confirmed.clear()
            if self.settings["confirm"]:
                self._tell(f"{_WAITING}: {following['protocol']}")
                while not self._confirmed.wait(_LOOK_EVERY):
                    self._heed()
            self._tell(f"{_RUNNING}: {following['protocol']}")
            self._calls.run_recorded(
                following["file"], following["protocol"], 60.0 * following["minutes"],
                following["bag"], self._heed, self.get_parameter("use_sim_time").value,
            )

    def _diagnosing(self, share: float, what: str) -> None:
        if self._stopping.is_set():  # it came before the process had begun
            self._worker.cancel()
        self._tell(f"diagnosing: {100.0 * share:.0f} %, {what}")

    def _heed(self, _: str = "") -> None:
        if self._stopping.is_set():
            raise InputError("stopped on request")

    def _tell(self, state: str) -> None:
        self._text = state
        self._state.publish(String(data=state))
