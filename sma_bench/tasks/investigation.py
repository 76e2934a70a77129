"""Record, diagnose all records together, run the proposed experiment, and again: until the cause is
named, no experiment would decide, or the time is spent. The state is kept in a folder:

    believed.yaml           the stated parameters; results of the paper's tests are entered here
    record_1, record_2, ... bags recorded here, besides those that were given
    protocol_2.yaml         the protocol proposed for record_2
    diagnosis_1.json        of all records up to then
    investigation.json      the history: records, minutes, probabilities"""

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from sma_bench.border import MEGABYTE, read_json, read_text
from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.next_experiment import FIRST
from sma_bench.diagnose.result import NO_GAP, RECALIBRATION, UNEXPLAINED, diagnosis_from
from sma_bench.errors import InputError, errors_in
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.progress import Report, silent
from sma_bench.protocols import load_protocol
from sma_bench.report.page import Made, Section, Table, write_report
from sma_bench.results import card, percent
from sma_bench.tasks.work import diagnose_files, write_improved

HEADER = ("records", "minutes", "verdict", "probabilities", "then")
BELIEVED, STORY = "believed.yaml", "investigation.json"
OPEN, NAMED, INSEPARABLE, SPENT, TEST = ("open", "named", "inseparable", "budget spent",
                                         "a test is needed")
_ABOVE_FINISH = 25.0  # K above A_f: the steady temperature of the first drive
_MOST_SHOWN = 5  # candidates in a row of the table
_SURE = 0.8  # probability of an effect from which no further experiment is needed
_CHAPTER = 8 * MEGABYTE  # largest file


@dataclass(frozen=True)
class Chapter:
    """One diagnosis, after so many records and minutes; `proposed`: next experiment, {}: none."""

    records: int
    minutes: float
    verdict: str
    cause: list[str]
    probabilities: dict[str, float]
    why: list[str] = field(default_factory=list)
    proposed: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Story:
    given: list[str]
    chapters: list[Chapter]


@dataclass(frozen=True)
class _Proposed:
    """The fields of `Chapter.proposed` that are used here."""

    why: str
    protocol: dict[str, Any]
    separates: list[str]
    kind: str = ""
    minutes: float = 0.0


class Investigation:
    """An investigation in its folder; steps whose files exist there are not repeated."""

    def __init__(self, folder: str | Path, budget: float,
                 signals: Sequence[str] = QUANTITIES) -> None:
        """`budget`: minutes that the bench may be driven in all."""
        self.folder, self._budget, self._signals = Path(folder), budget, tuple(signals)
        self.given: list[str] = []
        self.chapters: list[Chapter] = []
        if os.path.isfile(path := self.folder / STORY):  # False for an impossible name, too
            import msgspec  # may be missing on a robot

            found = read_json(read_text(path, _CHAPTER), str(path), _CHAPTER)
            try:
                story = msgspec.convert(found, _Story)
                for chapter in story.chapters:
                    msgspec.convert(chapter.proposed or None, _Proposed | None)
            except msgspec.ValidationError as error:
                raise InputError(f"{path}: damaged: {error}") from None
            self.chapters, self.given = story.chapters, story.given

    def begin(self, parameters: Parameters, given: Sequence[str]) -> None:
        """Keep parameters and paths of records; if begun already, add the new records."""
        begun = os.path.isfile(self.folder / BELIEVED)
        with errors_in(f"{self.folder}: cannot be made"):
            self.folder.mkdir(parents=True, exist_ok=True)
            is_new = begun or not any(self.folder.iterdir())
        if not is_new:
            raise InputError(f"{self.folder}: is not empty and holds no investigation")
        paths = [str(Path(path).resolve()) for path in given]
        self.given += [path for path in paths if path not in self.given]
        self._keep()
        if not begun:
            names = sorted(parameters.given) or None  # None: write all, as a file must not be empty
            write_parameters(self.folder / BELIEVED, parameters, "As stated.", names)

    @property
    def believed(self) -> Parameters:
        return read_parameters(self.folder / BELIEVED)

    def _own(self) -> list[tuple[Path, Path]]:
        """Bags recorded in this folder, with their protocols."""
        pairs = ((self.folder / f"record_{k}", self.folder / f"protocol_{k}.yaml")
                 for k in range(1, 1000))
        return [(bag, protocol) for bag, protocol in pairs if bag.exists()]

    @property
    def records(self) -> list[str]:
        return [*self.given, *(str(bag) for bag, _ in self._own())]

    @property
    def minutes(self) -> float:
        """Time for which the bench was driven in this investigation."""
        done = [protocol for _, protocol in self._own() if protocol.is_file()]
        return sum(load_protocol(path, self.believed).duration / 60.0 for path in done)

    def next_run(self) -> dict[str, Any]:
        """Write the next protocol to a file. Returns its name (`protocol`), `minutes`, highest
        `volts`, the `file`, and the `bag` to record. InputError: it exceeds the bench's limits."""
        number, p = len(self._own()) + 1, self.believed
        path = self.folder / f"protocol_{number}.yaml"
        if self.chapters:
            document = self.chapters[-1].proposed["protocol"]
        else:
            # Strokes of growing height on each side, up to a steady temperature above A_f.
            excess = p["wire.austenite_finish_temperature"] + _ABOVE_FINISH
            excess -= p["environment.ambient_temperature"]
            loss = p["wire.heat_transfer_coefficient"] * p["wire.surface_area"]
            level = min(math.sqrt(p["wire.resistance"] * loss * excess), p["bench.maximum_voltage"])
            document = FIRST.document(level, tuple(dict.fromkeys(p["bench.channel_sides"])))
        # A unique name: the experiment node's `done: NAME` may still be that of the run before.
        document = {**document, "name": f"{document['name']}_{number}"}
        write_text_atomically(path, json.dumps(document, indent=1) + "\n")  # YAML as well
        protocol = load_protocol(path, p)
        return {"protocol": protocol.name, "minutes": protocol.duration / 60.0,
                "volts": max(max(*s.start, *s.stop) for s in protocol.segments), "file": str(path),
                "bag": str(self.folder / f"record_{number}")}

    @property
    def pending(self) -> bool:
        """True if records are new, or parameters changed, since the last diagnosis."""
        if not self.chapters:
            return bool(self.records)
        changed = (self.folder / BELIEVED).stat().st_mtime_ns > self._last.stat().st_mtime_ns
        return len(self.records) > self.chapters[-1].records or changed

    @property
    def _last(self) -> Path:
        return self.folder / f"diagnosis_{len(self.chapters)}.json"

    def diagnose(self, report: Report = silent) -> Diagnosis:
        """Diagnose all records together and write the next chapter."""
        records = self.records
        result = diagnose_files(records, [], self.believed, self._signals, report)
        document = result.to_json()
        write_improved(self.folder / "improved.yaml", result, "sma-bench investigate")
        probabilities = {c["name"]: c["probability"] for c in document["candidates"]}
        self.chapters.append(Chapter(
            len(records), self.minutes, document["verdict"], document["cause"], probabilities,
            document["why"], document["next_experiment"] or {}))
        write_text_atomically(self._last, json.dumps(document, indent=1) + "\n")
        self._keep()
        return result

    @property
    def state(self) -> str:
        """OPEN: there is a next run; otherwise the reason why the investigation ends."""
        if not self.chapters:
            return OPEN
        last = self.chapters[-1]
        sure = last.verdict == "effect" and max(last.probabilities.values()) >= _SURE
        if sure or not last.proposed.get("separates"):
            named = last.verdict in ("effect", RECALIBRATION, NO_GAP, UNEXPLAINED)
            return NAMED if named else INSEPARABLE
        if not last.proposed["protocol"] or last.proposed.get("kind") == "sensor":
            return TEST
        return SPENT if self.minutes + last.proposed["minutes"] > self._budget else OPEN

    def rows(self) -> list[tuple[str, ...]]:
        """After each diagnosis: records, minutes, verdict, probabilities, what was done next."""
        rows: list[tuple[str, ...]] = []
        for c in self.chapters:
            ranked = sorted(c.probabilities.items(), key=lambda pair: -pair[1])[:_MOST_SHOWN]
            likely = ", ".join(f"{name} {percent(p)}" for name, p in ranked if p >= 0.02)
            named, then = ", ".join([c.verdict, *c.cause]), c.proposed.get("why", "")
            rows.append((str(c.records), f"{c.minutes:.1f}", named, likely, then.partition(":")[0]))
        return rows

    def write_page(self, command: str = "") -> Path:
        """Write the history as a page; its path. `command`: for the provenance."""
        where = str(self._last)
        document = read_json(read_text(where, _CHAPTER), where, _CHAPTER)
        answer = Section("", card=card(diagnosis_from(document, where)))
        sections = [Section(f"After {_counted(c.records)}", [*c.why],
                            notes=[c.proposed["why"]] if c.proposed else [])
                    for c in self.chapters]
        table = Table(HEADER, self.rows(), frozenset({0, 1}), "story", "After each diagnosis")
        return write_report(self.folder / "story", "Investigation", f"{self.summary()}.",
                            [answer, Section("History", tables=[table]), *sections],
                            Made(command, self.records))

    @property
    def outcome(self) -> str:
        last = self.chapters[-1]
        return f"{self.state}: {' and '.join(last.cause) or last.verdict}"

    def summary(self) -> str:
        last = self.chapters[-1]
        return f"{self.outcome} after {_counted(last.records)}, {last.minutes:.1f} min"

    def to_json(self) -> dict[str, Any]:
        """The history and the state."""
        return {"given": self.given, "chapters": [*map(asdict, self.chapters)], "state": self.state}

    def _keep(self) -> None:
        write_text_atomically(self.folder / STORY, json.dumps(self.to_json(), indent=1) + "\n")


def _counted(records: int) -> str:
    return f"{records} record{'s' if records != 1 else ''}"
