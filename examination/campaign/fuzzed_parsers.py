"""Parsers of what comes from outside, fed with anything: a result or InputError in one line.

By hypothesis: good inputs cut, spliced, repeated, and sown with what trips parsers.
"""

import logging
import warnings
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from examination.campaign.allowance import allowance
from examination.campaign.outcome import Outcome
from examination.campaign.parser_seeds import Parser, parsers
from sma_bench.errors import InputError

MEMORY = 1 << 30
SECONDS = 10.0
_SHOWN = 120

# A YAML document that is a kilobyte as a file and gigabytes when every alias is followed.
_BOMB = b"a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + b"".join(
    b"a%d: &a%d [%s]\n" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)) for k in range(1, 12)
)
_MAP_BOMB = b"b0: &b0 {x: 1, y: 2}\n" + b"".join(
    b"b%d: &b%d {%s}\n" % (k, k, b", ".join(b"k%d: *b%d" % (n, k - 1) for n in range(9)))
    for k in range(1, 12)
)
TRIPWIRES = (
    b"nan", b"-inf", b"1e999", b"-1", b"0", b"9" * 400, b"9" * 5000, b"0x" + b"f" * 5000, b"1e-400",
    b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\t", b"\n\n", b",", b";", b"{", b"[" * 3000, b"]",
    b"!!python/object/apply:os.system [id]", b"!!binary x", b"!!set {a}", b"2020-13-45", b"<<: *a",
    b"? [a]", b"*a", b"&a", b"1:2:3:4:5", b"~", b"true", b"''", b'""', b"{}", b"[]", b"\xc3\x28",
    b"\xe2\x80\xa8", b"=", b"|", b">", b"%", b"---\n", b"...\n", b"\\", b"null", b"[[1, 2], [3]]",
    b"\n" + _BOMB, b"\n" + _MAP_BOMB, b".." * 50, b"/dev/zero", b"1" + b"0" * 30 + b".0",
)  # fmt: skip

_place = st.floats(0.0, 1.0, exclude_max=True)
_edit = st.tuples(
    st.sampled_from(["cut", "drop", "twice", "insert", "replace"]),
    _place, st.integers(1, 40),
    st.one_of(st.sampled_from(TRIPWIRES), st.binary(max_size=12), st.text(max_size=8).map(
        lambda text: text.encode("utf-8", "surrogatepass"))),
)  # fmt: skip
_edits = st.lists(_edit, min_size=1, max_size=5)

Edit = tuple[str, float, int, bytes]


def edited(content: bytes, edits: list[Edit]) -> bytes:
    """Apply edits: cut off, drop, repeat, insert or replace `n` bytes or a whole token."""
    for kind, place, n, payload in edits:
        at = int(place * (len(content) + 1))
        end = at + n
        if kind == "replace":  # a whole token: what a file's author would have got wrong
            end = at
            while end < len(content) and content[end : end + 1] not in b" \t\n,:{}[]":
                end += 1
        content = {
            "cut": content[:at],
            "drop": content[:at] + content[end:],
            "twice": content[:end] + content[at:],
            "insert": content[:at] + payload + content[at:],
            "replace": content[:at] + payload + content[end:],
        }[kind]
    return content


def try_input(parser: Parser, content: bytes, folder: Path) -> str:
    """What went wrong with one input, or ""."""
    path = folder / parser.file
    path.write_bytes(content)
    try:
        with allowance(MEMORY, SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parser.read(path)
    except InputError as error:
        return "" if "\n" not in str(error) else f"more than one line: {str(error)[:_SHOWN]!r}"
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {str(error)[:_SHOWN]!r}"
    return ""


def fuzzed_parsers(size: int, number: int, folder: Path) -> list[Outcome]:
    """`size` inputs by hypothesis for every parser."""
    logging.disable(logging.WARNING)
    try:
        return [_by_hypothesis(parser, size, number, folder) for parser in parsers()]
    finally:
        logging.disable(logging.NOTSET)


def _by_hypothesis(parser: Parser, size: int, number: int, folder: Path) -> Outcome:
    folder.mkdir(parents=True, exist_ok=True)
    wrong: dict[str, bytes] = {}
    tried = 0

    @seed(number)
    @settings(
        max_examples=size, deadline=None, database=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(_edits)
    def feed(edits: list[Edit]) -> None:
        nonlocal tried
        tried += 1
        content = edited(parser.seed, edits)
        if text := try_input(parser, content, folder):
            kept = wrong.setdefault(text.split(":")[0], content)
            if len(content) < len(kept):
                wrong[text.split(":")[0]] = content

    feed()
    good = try_input(parser, parser.seed, folder)
    for name, content in wrong.items():
        good += f"; {name} at {content[:_SHOWN]!r}"
    return Outcome(
        "parsers", f"hypothesis: {parser.name}", tried, f"failed {len(wrong)}{good}", "failed 0",
        not wrong and not good,
    )
