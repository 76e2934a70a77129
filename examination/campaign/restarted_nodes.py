"""Nodes killed and started again in every order: 0 V meanwhile, and the bench works afterwards."""

import time
from itertools import permutations, product
from pathlib import Path

from sensor_msgs.msg import BatteryState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from examination.campaign.bench_nodes import Talker, bench_nodes
from examination.campaign.outcome import Outcome
from sma_bench.records import read_record

NODES = ("simulator", "experiment", "recorder")
# The contract's command timeout, and what a busy machine needs to notice.
_ATTEMPTS = 20
_TIMEOUT, _SLACK = 0.5, 1.0
_VOLTS = 1.0
# A killed recorder has lost a second.
_TO_DISK = 1.5
_PROTOCOL = """\
name: hold
description: held volts
steps:
  - {kind: hold, name: warm, level: %g, duration: 600.0}
"""


def orders() -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Every order of killing with every order of starting again."""
    return list(product(permutations(NODES), repeat=2))


def restarted_nodes(size: int, seed: int, folder: Path) -> list[Outcome]:
    """`size` of the 36 pairs of orders, spread evenly."""
    every, wrong = orders(), []
    for k in range(size):
        end, begin = every[(seed + k * len(every) // size) % len(every)]
        try:
            with bench_nodes(folder / f"{k}" / "logs") as talker:
                wrong.append(_restart(talker, end, begin, folder / f"{k}"))
        except Exception as error:  # that is what is looked for
            wrong.append(f"killed {end}, started {begin}: {type(error).__name__}: {error}")
    limit = "0 V while driven by nobody, works again, both bags read"
    what = "kill -9 and start again, all orders of three nodes"
    return [Outcome.of("restarts", what, size, wrong, limit)]


def _restart(
    talker: Talker, end: tuple[str, ...], begin: tuple[str, ...], folder: Path
) -> str:
    protocol = folder / "hold.yaml"
    protocol.write_text(_PROTOCOL % _VOLTS)
    bags = iter([folder / "before", folder / "after"])
    parameters = {"experiment": {"protocol": str(protocol)}, "simulator": {}}
    powers = talker.heard("wire/power", BatteryState)
    recorders = talker.heard("recorder/state", String, latched=True)

    def start(name: str) -> None:
        own = {"output": str(next(bags))} if name == "recorder" else parameters[name]
        talker.nodes.start(name, own)

    def drive() -> None:
        powers.clear()
        talker.until("readings", lambda: powers)
        talker.until("recorded", lambda: recorders and "wire/power" in recorders[-1].data)
        talker.parameters_of("experiment")
        for _ in range(_ATTEMPTS):
            answer = talker.call(Trigger, "experiment/start")
            if answer.success:
                break
            talker.listen(0.5)  # readings reach each node in its own time
        else:
            raise RuntimeError(answer.message)
        talker.until("driven", lambda: powers[-1].voltage > 0.5 * _VOLTS)
        talker.listen(_TO_DISK)

    for name in NODES:
        start(name)
    drive()
    for name in end:
        talker.kill(name)
        if name == "experiment" and "simulator" in end[end.index(name) + 1 :]:
            killed = time.monotonic()
            talker.until("0 V", lambda: powers[-1].voltage < 0.1 * _VOLTS)
            if (took := time.monotonic() - killed) > _TIMEOUT + _SLACK:
                return f"outputs on for {took:.2f} s after the experiment was killed"
    recorders.clear()
    for name in begin:
        start(name)
    talker.listen(0.5)  # what the killed one sent
    powers.clear()
    talker.until("readings again", lambda: len(powers) > 5)
    if max(power.voltage for power in powers) > 0.1 * _VOLTS:
        return "driven without a start"
    drive()
    for name in NODES[::-1]:
        talker.nodes.end(name)
    for bag in ("before", "after"):
        record = read_record(folder / bag)
        if record["wire.voltage"].values.max() < 0.5 * _VOLTS:
            return f"the drive is not in the bag {bag}"
    return ""
