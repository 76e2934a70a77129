"""A process of atheris (libFuzzer): the first byte picks the parser, the rest is its input.

    python guided_fuzzing.py -runs=N FOLDER      what fails is noted in FOLDER/found.json
"""

import json
import logging
import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["sma_bench", "yaml"]):
    from examination.campaign.fuzzed_parsers import TRIPWIRES, edited, try_input
    from examination.campaign.hostile_inputs import targets

PARSERS = targets()


def main(arguments: list[str]) -> None:
    """Never returns: libFuzzer ends the process."""
    logging.disable(logging.WARNING)
    corpus = Path(arguments[-1])
    for number, parser in enumerate(PARSERS):
        (corpus / f"seed_{number}").write_bytes(bytes([number]) + parser.seed)
        for k, tripwire in enumerate(TRIPWIRES):
            if len(tripwire) < 100:
                content = edited(parser.seed, [("replace", (k + 1) / len(TRIPWIRES), 1, tripwire)])
                (corpus / f"trip_{number}_{k}").write_bytes(bytes([number]) + content)
    folder = corpus / "input"
    folder.mkdir()

    def feed(data: bytes) -> None:
        if not data:
            return
        parser = PARSERS[data[0] % len(PARSERS)]
        if text := try_input(parser, data[1:], folder):
            found = f"{parser.name}: {text} at {data[1:200]!r}"
            (corpus / "found.json").write_text(json.dumps(found))
            raise RuntimeError(found)

    atheris.Setup([sys.argv[0], *arguments], feed)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
