"""Record, diagnose, propose, run, diagnose everything together: until the cause is named, nothing
more would settle it, or the time is spent. Kept in a folder after every step, to go on from there.

    believed.yaml           parameters as believed; tests of the paper go in here
    record_1, record_2, ... bags, beside those that were given
    protocol_2.yaml         what was proposed for record_2
    diagnosis_1.json        of all records up to then
    investigation.json      the story: records, minutes, probabilities
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.border import MEGABYTE, read_json, read_text
from sma_bench.cards import card
from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.decision import NO_GAP, RECALIBRATION, UNEXPLAINED
from sma_bench.diagnose.drives import FIRST
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.progress import Report, silent
from sma_bench.protocols import Protocol, load_protocol
from sma_bench.report.page import Made, Section, Table, write_report
from sma_bench.results import percent
from sma_bench.tasks.work import diagnose_files, write_improved

BELIEVED, STORY = "believed.yaml", "investigation.json"
OPEN, NAMED, INSEPARABLE, SPENT, TEST = (
    "open", "named", "inseparable", "budget spent", "a test is needed"
)
_ABOVE_FINISH = 25.0  # K to which the first drive heats a wire at rest
_MOST_SHOWN = 5
_SURE = 0.8  # probability from which an effect needs no more
_CHAPTER = 8 * MEGABYTE


@dataclass(frozen=True)
class Chapter:
    """What was said after so many records.

    Attributes:
        records: how many there were; minutes: that the bench was driven for them.
        verdict, cause, probabilities: of the diagnosis; proposed: the experiment, {} for none.
    """

    records: int
    minutes: float
    verdict: str
    cause: list[str]
    probabilities: dict[str, float]
    why: list[str] = field(default_factory=list)
    proposed: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class NextRun:
    """What is proposed: the protocol and its file, and the bag that it is to be recorded in."""

    file: Path
    protocol: Protocol
    bag: Path

    def to_json(self) -> dict[str, Any]:
        """For whoever confirms and runs it; `volts` is the highest."""
        return {
            "protocol": self.protocol.name, "minutes": self.protocol.duration / 60.0,
            "volts": max(max(*s.start, *s.stop) for s in self.protocol.segments),
            "file": str(self.file), "bag": str(self.bag),
        }


class Investigation:
    """One folder; what is in it already is not done again."""

    def __init__(
        self, folder: str | Path, budget: float, signals: Sequence[str] = QUANTITIES
    ) -> None:
        """`budget`: minutes that the bench may be driven in all."""
        self.folder, self._budget, self._signals = Path(folder), budget, tuple(signals)
        story = self._story()
        self.given: list[str] = list(story.get("given", []))
        self.chapters = [Chapter(**chapter) for chapter in story.get("chapters", [])]

    def begin(self, parameters: Parameters, given: Sequence[str]) -> None:
        """Keep what is believed and which records there are; where it has begun, what is new."""
        begun = (self.folder / BELIEVED).is_file()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not begun and any(self.folder.iterdir()):
                raise InputError(f"{self.folder}: is not empty, and no investigation")
        except OSError as error:
            raise InputError(f"{self.folder}: cannot be made: {error.strerror}") from None
        paths = [str(Path(path).resolve()) for path in given]
        self.given += [path for path in paths if path not in self.given]
        self._keep()
        if not begun:
            names = sorted(parameters.given)
            write_parameters(self.folder / BELIEVED, parameters, "As believed.", names)

    @property
    def believed(self) -> Parameters:
        """As they stand in the folder."""
        return read_parameters(self.folder / BELIEVED)

    @property
    def records(self) -> list[str]:
        """All bags."""
        own = (self._own(k) for k in range(1, 1000))
        return [*self.given, *(str(bag) for bag in own if bag.exists())]

    def _own(self, number: int) -> Path:
        return self.folder / f"record_{number}"

    @property
    def minutes(self) -> float:
        """That the bench was driven here."""
        protocols = (self.folder / f"protocol_{k}.yaml" for k in range(1, 1000))
        done = [p for k, p in enumerate(protocols, 1) if p.is_file() and self._own(k).exists()]
        return sum(load_protocol(path, self.believed).duration / 60.0 for path in done)

    def next_run(self) -> NextRun:
        """What the bench is to be driven with next; its file is written.

        Raises:
            InputError: the bench's limits refuse it.
        """
        number = len(self.records) - len(self.given) + 1
        path = self.folder / f"protocol_{number}.yaml"
        document = self.chapters[-1].proposed["protocol"] if self.chapters else self._first()
        # The experiment node says `done: NAME`, also of a run before.
        document = {**document, "name": f"{document['name']}_{number}"}
        write_text_atomically(path, json.dumps(document, indent=1) + "\n")  # YAML as well
        return NextRun(path, load_protocol(path, self.believed), self._own(number))

    def _first(self) -> dict[str, Any]:
        """Strokes of growing height on each side, up to a steady temperature above A_f."""
        p = self.believed
        excess = p["wire.austenite_finish_temperature"] + _ABOVE_FINISH
        excess -= p["environment.ambient_temperature"]
        loss = p["wire.heat_transfer_coefficient"] * p["wire.surface_area"]
        level = min(float(np.sqrt(p["wire.resistance"] * loss * excess)),
                    float(p["bench.maximum_voltage"]))
        return FIRST.document(level, tuple(dict.fromkeys(p["bench.channel_sides"])))

    @property
    def pending(self) -> bool:
        """Whether a record has come since the last diagnosis, or the parameters have changed."""
        if not self.chapters:
            return bool(self.records)
        last = self.folder / f"diagnosis_{len(self.chapters)}.json"
        changed = (self.folder / BELIEVED).stat().st_mtime_ns > last.stat().st_mtime_ns
        return len(self.records) > self.chapters[-1].records or changed

    def diagnose(self, report: Report = silent) -> Diagnosis:
        """Of all records together; the next chapter."""
        records = self.records
        result = diagnose_files(records, [], self.believed, self._signals, report)
        document = result.to_json()
        number = len(self.chapters) + 1
        write_improved(self.folder / "improved.yaml", result, "sma-bench investigate")
        self.chapters.append(Chapter(
            len(records), self.minutes, document["verdict"], document["cause"],
            {c["name"]: c["probability"] for c in document["candidates"]}, document["why"],
            document["next_experiment"] or {},
        ))
        write_text_atomically(
            self.folder / f"diagnosis_{number}.json", json.dumps(document, indent=1) + "\n"
        )
        self._keep()
        return result

    @property
    def state(self) -> str:
        """Whether, and why not, there is a next run."""
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

    # --- the story ----------------------------------------------------------------------------

    def rows(self) -> list[tuple[str, ...]]:
        """After each diagnosis: records, minutes, verdict, probabilities, what was done next."""
        return [
            (str(c.records), f"{c.minutes:.1f}", ", ".join([c.verdict, *c.cause]), _likely(c),
             c.proposed.get("why", "").partition(":")[0])
            for c in self.chapters
        ]

    def write_page(self, command: str = "") -> Path:
        """The story as a page, by this command; its path."""
        made = Made(command, self.records)
        last = self.folder / f"diagnosis_{len(self.chapters)}.json"
        document = read_json(read_text(last, _CHAPTER), str(last), _CHAPTER)
        answer = Section("", card=card(diagnosis_from(document, str(last))))
        sections = [
            Section(f"After {c.records} record{'s' if c.records != 1 else ''}", [*c.why],
                    notes=[c.proposed["why"]] if c.proposed else [])
            for c in self.chapters
        ]
        table = Table(HEADER, self.rows(), frozenset({0, 1}), "story", "Probabilities by record")
        return write_report(
            self.folder / "story", "Investigation", f"{self.summary()}. {made.head}",
            [answer, Section("Story", tables=[table]), *sections, made.section()],
        )

    @property
    def outcome(self) -> str:
        """The state, and of what."""
        last = self.chapters[-1]
        return f"{self.state}: {' and '.join(last.cause) or last.verdict}"

    def summary(self) -> str:
        """The last word."""
        last = self.chapters[-1]
        count = f"{last.records} record{'s' if last.records != 1 else ''}"
        return f"{self.outcome} after {count}, {last.minutes:.1f} min"

    def to_json(self) -> dict[str, Any]:
        """The story and its state."""
        return {**self._told(), "state": self.state}

    def _told(self) -> dict[str, Any]:
        return {"given": self.given, "chapters": [asdict(c) for c in self.chapters]}

    def _keep(self) -> None:
        write_text_atomically(self.folder / STORY, json.dumps(self._told(), indent=1) + "\n")

    def _story(self) -> dict[str, Any]:
        path = self.folder / STORY
        if not path.is_file():
            return {}
        found = read_json(read_text(path, _CHAPTER), str(path), _CHAPTER)
        try:
            [Chapter(**chapter) for chapter in found["chapters"]]
            return {"given": [str(p) for p in found["given"]], "chapters": found["chapters"]}
        except (KeyError, TypeError) as error:
            raise InputError(f"{path}: damaged: {error}") from None


HEADER = ("records", "minutes", "verdict", "probabilities", "then")


def _likely(chapter: Chapter) -> str:
    ranked = sorted(chapter.probabilities.items(), key=lambda pair: -pair[1])
    return ", ".join(f"{name} {percent(p)}" for name, p in ranked[:_MOST_SHOWN] if p >= 0.02)
