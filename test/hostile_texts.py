"""Hostile texts of a kind: `topics`, `json`, `yaml`; and YAML whose merge keys multiply."""

from pathlib import Path

import yaml

MERGED = "b0: &b0 {x: 1, y: 2}\n" + "".join(
    f"b{k}: &b{k} {{<<: [*b{k - 1}, *b{k - 1}, *b{k - 1}], k{k}: 1}}\n" for k in range(1, 16)
)


def hostile(kind):
    texts = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())[kind]
    unfolded = [[text, "", 0, ""] if isinstance(text, str) else text for text in map(_text, texts)]
    return [head + part * times + tail for head, part, times, tail in unfolded]


def _text(entry):
    """A number that YAML read is a text all the same."""
    return entry if isinstance(entry, list | str) else str(entry)
