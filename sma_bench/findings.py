"""Findings: infos, warnings and errors about parameters, records and fits."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, cast, get_args

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """A remark with the numbers it is based on."""

    severity: Severity
    subject: str  # what it is about: a parameter, a signal, an experiment
    text: str
    numbers: dict[str, float] = field(default_factory=dict)  # behind `text`, in SI units
    audit: bool = False  # about the stated parameters, not about measurements

    @classmethod
    def read(cls, line: str) -> "Finding":
        """Parse the text that `str` gives; any other text becomes an info."""
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
    """The findings without those of the parameters' audit; and the latter, if any, after one that
    sums them up."""
    others, audited = ([f for f in findings if f.audit == is_one] for is_one in (False, True))
    clashes = [f.subject for f in audited if f.severity != "info"]
    papers = sum(int(f.numbers.get("clashes", 0)) for f in audited)
    own_clashes = f"{len(clashes)} clash ({', '.join(clashes)})" if clashes else "no clash"
    own = f"; the paper's own: {papers} clash" if papers else ""
    line = f"stated parameters: {own_clashes}{own}; sma-bench audit lists them"
    return others, [Finding("info", "audit", line), *audited] if audited else []
