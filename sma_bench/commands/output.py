"""How commands print findings and write results."""

import json
import math
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.text import Text

from sma_bench.findings import Finding
from sma_bench.parameters.yaml_file import write_text_atomically

_STYLES = {"info": "green", "warning": "yellow", "error": "red"}


def print_findings(findings: Iterable[Finding]) -> None:
    """One paragraph a finding, coloured on a terminal."""
    console = Console(highlight=False)
    for finding in findings:
        head = Text(f"{finding.severity:8}", style=_STYLES[finding.severity])
        console.print(head + Text(f"{finding.subject}: {finding.text}", style="default"))


def write_json(path: str, document: dict[str, Any]) -> None:
    """Write a result file, whole or not at all.

    Raises:
        InputError: the folder cannot be written.
    """
    write_text_atomically(path, json_text(document))


def json_text(document: dict[str, Any]) -> str:
    """A result as JSON; NaN becomes null so that any reader takes it."""
    return json.dumps(_finite(document), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
