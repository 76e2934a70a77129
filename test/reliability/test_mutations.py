"""Mutations of the safety rules: where they are made, and that tests catch some and not all."""

import itertools

import pytest

from examination.check import mutations
from examination.check.mutations import KINDS, PURE, SURVIVED, Mutation

PYTHON = '''\
LIMIT = 3.0

class Rule:
    def holds(self, value):
        """Not 4."""
        self.seen = value
        self.note(value)
        if value < self.timeout and not self.off:
            return f"{value:5.1f}"
'''
C = """\
#define LEAST 2
_Static_assert(LEAST < 4,
               "5");
static bool holds(uint8_t value)
{
    uint8_t most = 7; /* < 8 */
    seen = value;
    stop(value);
    if (value <= MOST_MS && !off)
        return "a < b" != NULL;
    return x->y << 1;
}
"""


@pytest.mark.parametrize(
    ("edits", "source", "expected"),
    [
        (mutations.python_edits, PYTHON, {
            ("", "3.0", "6.0"), ("Rule.holds", "self.seen = value", "pass"),
            ("Rule.holds", "self.note(value)", "pass"), ("Rule.holds", "<", ">"),
            ("Rule.holds", "and", "or"), ("Rule.holds", "not ", ""),
            ("Rule.holds", "self.timeout", "(2.0 * self.timeout)"),
        }),
        (mutations.c_edits, C, {
            ("LEAST", "2", "(2 * 2)"), ("holds", "7", "(2 * 7)"), ("holds", "<=", ">="),
            ("holds", "seen = value;", "(void)0;"), ("holds", "stop(value);", "(void)0;"),
            ("holds", "MOST_MS", "(2 * MOST_MS)"), ("holds", "&&", "||"), ("holds", "!", ""),
            ("holds", "!=", "=="), ("holds", "1", "(2 * 1)"),
        }),
    ],
)  # fmt: skip
def test_every_comparison_limit_and_state_is_found_and_nothing_that_is_only_said(
    edits, source, expected
):
    found = list(edits(source))
    assert {(place, before, after) for place, _, _, before, after in found} == expected
    assert all(source[at:].startswith(before) for _, _, at, before, _ in found)


def test_a_draw_has_every_kind_of_every_file_and_is_the_same_again():
    drawn = mutations.drawn(60, 1)
    assert drawn == mutations.drawn(60, 1) != mutations.drawn(60, 2)
    assert {one.kind for one in drawn} == set(KINDS) and len({one.name for one in drawn}) == 60
    every = [one.name for file in mutations.FILES for one in mutations.mutations_of(file)]
    assert len(every) == len(set(every)) > 500
    assert set(mutations.EQUIVALENT) <= set(every), "mutations.yaml explains what is not there"


def test_a_rule_that_is_broken_is_caught_by_its_tests_and_a_comment_is_not():
    copy = mutations.Copy()
    file = "sma_bench/hardware/safety.py"
    mutation = next(one for one in mutations.mutations_of(file)
                    if (one.place, one.before) == ("Watchdog.expired", "<="))  # fmt: skip
    source = (copy.root / file).read_text()
    harmless = Mutation(file, "", KINDS[0], source.index("# A clock"), "# A", "#", 1, "", 0)
    few = {"tests": ["test/hardware/test_safety.py", "-k", "watchdog"], "faults": {}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(mutations.FILES, file, few)
        assert [copy.outcome(one) for one in (mutation, harmless)] == [PURE, SURVIVED]
    assert (copy.root / file).read_text() == source


def test_a_survivor_without_a_reason_counts_against_the_tests(capsys, monkeypatch):
    three = list(itertools.islice(mutations.mutations_of("firmware/safety.c"), 3))
    monkeypatch.setattr(mutations, "EQUIVALENT", {three[0].name: "both are 0 there"})
    share = mutations.report(dict(zip(three, (SURVIVED, SURVIVED, PURE), strict=True)))
    assert share == 0.5
    said = capsys.readouterr().out
    assert "both are 0 there" in said and said.count("NO TEST") == 1
