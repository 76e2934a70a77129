"""What the benchmark says: figures with their aims, one table a section, all of them as JSON."""

import math
import os
import platform
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any

from rich.console import Console
from rich.table import Table

_WIDE = 140
_PACKAGES = (
    "sma_bench", "numpy", "scipy", "numba", "rosbags", "scikit-sundae", "mcap-ros2-support",
    "distributed",
)


@dataclass(frozen=True)
class Figure:
    """One number: of which case, what was measured, and what was aimed at ("least" or "most")."""

    case: str
    measure: str
    value: float
    unit: str
    aim: tuple[str, float] | None = None

    @property
    def met(self) -> bool | None:
        """Whether the aim is reached; None without one."""
        if self.aim is None:
            return None
        kind, limit = self.aim
        return bool(self.value >= limit if kind == "least" else self.value <= limit)


@dataclass(frozen=True)
class Skipped:
    """What was not measured, and why."""

    what: str
    why: str


Outcome = Figure | Skipped


def at_least(limit: float) -> tuple[str, float]:
    return "least", limit


def at_most(limit: float) -> tuple[str, float]:
    return "most", limit


def print_section(name: str, outcomes: Iterable[Outcome], seconds: float) -> None:
    """The figures of a section as a table, what was skipped below it."""
    console = Console(highlight=False, width=max(_WIDE, Console().width))
    table = Table(title=f"{name} ({seconds:.0f} s)", title_justify="left", box=None, pad_edge=False)
    for heading in ("case", "measure", "value", "unit", "aim", ""):
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=True)
    skipped = []
    for outcome in outcomes:
        if isinstance(outcome, Skipped):
            skipped.append(outcome)
            continue
        aim = f"at {outcome.aim[0]} {outcome.aim[1]:g}" if outcome.aim else ""
        verdict = {None: "", True: "met", False: "missed"}[outcome.met]
        value = f"{outcome.value:.3g}"
        table.add_row(outcome.case, outcome.measure, value, outcome.unit, aim, verdict)
    console.print(table)
    for outcome in skipped:
        console.print(f"not measured: {outcome.what}: {outcome.why}", soft_wrap=True)
    console.print()


def as_json(sections: dict[str, list[Outcome]]) -> dict[str, Any]:
    """Everything that was measured, where and with what."""
    return {
        "machine": machine(),
        "sections": {
            name: {
                "figures": [
                    {**asdict(f), "value": float(f.value) if math.isfinite(f.value) else None,
                     "met": f.met}
                    for f in outcomes if isinstance(f, Figure)
                ],
                "skipped": [asdict(s) for s in outcomes if isinstance(s, Skipped)],
            }
            for name, outcomes in sections.items()
        },
    }


def machine() -> dict[str, Any]:
    """Processor, load and versions."""
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0].partition(":")[2].strip() if names else platform.machine()


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
