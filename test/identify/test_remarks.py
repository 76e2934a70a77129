"""Every remark of the table can be made: its cause is used, and the facts in its text are given."""

import ast
import string
from pathlib import Path

import yaml

from sma_bench.identify.result import refusal, remark

ROOM = Path(remark.__code__.co_filename).parent
TABLE = yaml.safe_load((ROOM / "remarks.yaml").read_text("utf-8"))


def facts_of(entry):
    """Names that the text and the numbers of an entry stand on."""
    fields = (field for _, field, _, _ in string.Formatter().parse(entry["text"]) if field)
    names = {field.split("*")[0].split("/")[0].split(".")[0] for field in fields}
    return names | set(entry.get("numbers", ()))


def test_every_cause_has_its_facts_and_is_used():
    said = set()
    for path in ROOM.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                said.add(node.value)
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
                continue
            if node.func.id not in ("remark", "refusal", "words"):
                continue
            given = {keyword.arg for keyword in node.keywords}
            first = node.args[0]
            causes = (first.body, first.orelse) if isinstance(first, ast.IfExp) else (first,)
            for cause in (c.value for c in causes if isinstance(c, ast.Constant)):
                needed = facts_of(TABLE[cause])
                if "numbers" in given:
                    needed -= set(TABLE[cause].get("numbers", ()))
                assert None in given or needed <= given, (path.name, cause, needed - given)
                named = "subject" in given or "subject" in TABLE[cause] or len(node.args) > 2
                assert named or node.func.id != "remark", (path.name, cause)
    assert set(TABLE) <= said, set(TABLE) - said


def test_a_text_scales_its_facts_and_keeps_numbers_in_si_units():
    found = remark("size of the expansion", "warning", value=-0.3e6, std=1e4, alpha_E_low=0.15e6,
                   alpha_E_high=0.6e6, verdict="plausible")  # fmt: skip
    assert found.severity == "warning" and found.subject == "Theta_T"
    assert "Theta_T = -0.3 +- 0.01 MPa/K against -0.15 to -0.60 MPa/K" in found.text
    assert found.numbers["value"] == -0.3e6
    assert str(refusal("no motion", where="here")).startswith("here: no motion")
