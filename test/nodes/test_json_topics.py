"""JSON on topics: config/json_topics.json says of every such topic what it holds. What the nodes of
all these tests publish is held against it where it is heard (conftest)."""

import copy
import json

import json_schema
import pytest

STATE = {"state": "idle", "output": "bag", "failure": "", "messages": {"/bench/wire/power": 3}}
PROPOSED = {
    "kind": "DSC", "why": "", "separates": ["latent_heat"], "protocol": {}, "minutes": 30.0,
    "chance": 0.5, "parameters": {"wire.mass": 1e-6}, "quantities": [],
}  # fmt: skip
CHAPTER = {
    "records": 1, "minutes": 2.0, "verdict": "ambiguous", "cause": [], "probabilities": {"a": 1.0},
    "why": ["because"], "proposed": PROPOSED,
}  # fmt: skip
STORY = {"given": [], "chapters": [CHAPTER], "state": "open", "outcome": "", "next": None}


def changed(document, path, value):
    """The document with something else at a dotted path; `...` takes it away."""
    made = copy.deepcopy(document)
    *above, last = path.split(".")
    inner = made
    for name in above:
        inner = inner[int(name) if name.isdigit() else name]
    inner[last] = value
    if value is ...:
        del inner[last]
    return made


@pytest.mark.parametrize(
    ("topic", "document", "path", "value", "said"),
    [
        ("recorder/state", STATE, "state", "asleep", "it.state is 'asleep'"),
        ("recorder/state", STATE, "messages", ..., "it lacks messages"),
        ("recorder/state", STATE, "messages./bench/wire/power", -1, "power is -1"),
        ("recorder/state", STATE, "messages./bench/wire/power", True, "is True, expected"),
        ("recorder/state", STATE, "lamp", "on", "it has lamp"),
        ("investigation/result", STORY, "chapters.0.proposed.chance", "1", "proposed is none of 2"),
        ("investigation/result", STORY, "chapters.0.proposed", {}, ""),
        ("investigation/result", STORY, "next", {"protocol": "x"}, "it.next lacks minutes"),
    ],
)
def test_a_message_that_is_not_as_its_schema_says_is_found(topic, document, path, value, said):
    json_schema.check(f"/bench/{topic}", json.dumps(document))
    text = json.dumps(changed(document, path, value))
    if not said:
        json_schema.check(topic, text)
        return
    with pytest.raises(AssertionError, match=said):
        json_schema.check(f"/bench/{topic}", text)
