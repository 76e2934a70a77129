"""What a careful reader would remark about numbers, a record or a fit."""

from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """A remark with the numbers it rests on.

    `subject` names what it is about (a parameter, a signal, an experiment); `numbers` holds the
    figures behind `text`, in SI units, for machines.
    """

    severity: Severity
    subject: str
    text: str
    numbers: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary for a result file."""
        return {
            "severity": self.severity,
            "subject": self.subject,
            "text": self.text,
            "numbers": dict(self.numbers),
        }

    def __str__(self) -> str:
        return f"{self.severity}: {self.subject}: {self.text}"
