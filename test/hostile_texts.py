"""Hostile texts by kind: `topics`, `json`, `yaml`; YAML whose merge keys multiply; and values of a
parameter's type."""

import math
from pathlib import Path

import yaml

MERGED = "b0: &b0 {x: 1, y: 2}\n" + "".join(
    f"b{k}: &b{k} {{<<: [*b{k - 1}, *b{k - 1}, *b{k - 1}], k{k}: 1}}\n" for k in range(1, 16)
)

VALUES = {
    str: ["x" * 300, "hold at 1 V" * 40, "a/" * 3000, "/" + "y" * 300 + ".yaml", "a\nb", "\0",
          "/dev/zero", "/proc/self/mem", "../../etc/passwd",
          "'\"{}[]", "é" * 200, "x" * 100_000, "."],
    float: [math.nan, math.inf, -1e300, 1e300], int: [-(2**63), 2**63 - 1], bool: [],
}  # fmt: skip


def hostile_values(usual):
    """Hostile values for a parameter with this usual value."""
    if isinstance(usual, list | tuple):
        return [*([value] for value in VALUES[str]), ["a"] * 10_000]
    return VALUES[type(usual)]


def hostile(kind):
    texts = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())[kind]
    unfolded = [[text, "", 0, ""] if isinstance(text, str) else text for text in map(_text, texts)]
    return [head + part * times + tail for head, part, times, tail in unfolded]


def _text(entry):
    """The entry as text, also if YAML read a number."""
    return entry if isinstance(entry, list | str) else str(entry)
