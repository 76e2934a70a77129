"""The last diagnosis in a few lines: the verdict, its candidates, what shrinks, what next."""

import math
from pathlib import Path
from typing import Any

from sma_bench.border import read_json_object, shown
from sma_bench.errors import InputError
from sma_bench.results import DiagnoseResult, diagnosis_from, in_print

_MOST_CANDIDATES = 5
_LEAST_SHOWN = 0.005
_VERDICTS = {
    "recalibration": "The parameters are off; no effect is missing.",
    "no_gap": "There is no gap beyond the noise.",
    "ambiguous": "The records cannot tell the first of these apart.",
    "unexplained": "There is a gap that no effect of the library explains.",
}


def diagnosis_summary(text: str) -> dict[str, Any]:
    """What a page shows of a result as the diagnosis node latches it.

    Args:
        text: JSON of the contract.

    Returns:
        `verdict`, `candidates` (name, probability), `lines`; `problem` where it is no result.
    """
    try:
        where = "diagnosis/result"
        result = diagnosis_from(Path(where), read_json_object(text, where))
    except InputError as error:
        return {"problem": shown(str(error))}
    return {
        "verdict": shown(_verdict(result)),
        "candidates": [
            {"name": shown(c.name), "probability": round(c.probability, 4)}
            for c in result.candidates[:_MOST_CANDIDATES]
            if c.probability >= _LEAST_SHOWN
        ],
        "lines": [shown(line) for line in (*_shrinkage(result), result.next_experiment) if line],
    }


def _verdict(result: DiagnoseResult) -> str:
    if result.verdict == "effect":
        return f"The gap is explained by {' and '.join(result.cause)}."
    return _VERDICTS.get(result.verdict, result.verdict)


def _shrinkage(result: DiagnoseResult) -> list[str]:
    return [
        f"{s.quantity}: error {in_print(s.quantity, s.before)} rms before, "
        f"{in_print(s.quantity, s.after)} after, noise {in_print(s.quantity, s.noise)}"
        for s in result.shrinkage
        if math.isfinite(s.before)
    ]
