"""What a careful reader would remark about numbers, a record or a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast, get_args

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """A remark with the numbers it rests on."""

    severity: Severity
    subject: str  # what it is about: a parameter, a signal, an experiment
    text: str
    numbers: dict[str, float] = field(default_factory=dict)  # behind `text`, in SI units
    audit: bool = False  # of parameters that were given, not of what was measured

    @classmethod
    def read(cls, line: str) -> "Finding":
        """From what `str` makes of one; whatever else it is, it is no more than an info."""
        severity, _, rest = line.partition(": ")
        subject, _, text = rest.partition(": ")
        if severity not in get_args(Severity):
            return cls("info", "", line)
        return cls(cast(Severity, severity), subject, text)

    def to_json(self) -> dict[str, Any]:
        about = {"severity": self.severity, "subject": self.subject, "text": self.text}
        return {**about, "numbers": dict(self.numbers)}

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text}"


def fold_audit(findings: Sequence[Finding]) -> tuple[list[Finding], list[Finding]]:
    """The findings without those of the parameters' audit, and those behind one line that stands
    for them; both empty where there are none."""
    others, audited = ([f for f in findings if f.audit == is_one] for is_one in (False, True))
    clashes = [f.subject for f in audited if f.severity != "info"]
    papers = sum(int(f.numbers.get("clashes", 0)) for f in audited)
    said = f"{len(clashes)} clash ({', '.join(clashes)})" if clashes else "none clashes"
    own = f", {papers} of the paper's own do" if papers else ""
    line = f"of the lab's own numbers {said}{own}; sma-bench audit lists them"
    return others, [Finding("info", "audit", line), *audited] if audited else []
