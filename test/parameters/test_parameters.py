"""Validation of parameters; reading and writing of ROS parameter files."""

import os
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters, read_parameters, write_parameters
from sma_bench.parameters.node_tables import markdown
from sma_bench.parameters.yaml_file import write_named_values

NUMBERS = [p for p in TABLE if p.kind == "double"]
DEFAULTS = Parameters.defaults()
START, FINISH = "wire.austenite_start_temperature", "wire.austenite_finish_temperature"
ROOT = "/**:\n  ros__parameters:\n"
REFUSED = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text())


@pytest.fixture
def path(tmp_path):
    return tmp_path / "p.yaml"


def complaint(call, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        call(*args, **kwargs)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_defaults_are_the_papers_table_one_and_every_declaration_is_complete():
    table_one = {"wire.resistance": 2.6987, "wire.heat_transfer_coefficient": 403.26,
                 "wire.specific_heat": 343.2, "wire.mass": 0.091e-3, "wire.surface_area": 395.84e-6,
                 "environment.ambient_temperature": 296.15}  # fmt: skip
    assert {name: DEFAULTS[name] for name in table_one} == table_one
    for parameter in TABLE:
        assert parameter.description.endswith(".") and parameter.provenance, parameter.name
        assert parameter.validated(parameter.default) == parameter.default
        if parameter.kind == "double":
            assert parameter.unit and None not in (parameter.low, parameter.high)
    # Defaults that nobody stated give way to stated values.
    assert Parameters({START: 360.0})[FINISH] == pytest.approx(381.8)
    assert Parameters({FINISH: 330.0})[START] == pytest.approx(308.2)


@pytest.mark.parametrize(("values", "expected"), REFUSED["values"])
def test_a_wrong_value_is_refused_with_what_was_expected(values, expected):
    assert expected in complaint(Parameters, values)
    assert expected in complaint(DEFAULTS.replace, values)


def test_a_deviation_is_the_stated_one_else_the_tables_of_a_stated_value_else_that_of_the_field():
    p = Parameters({"wire.resistance": 2.7})
    assert p.std("wire.resistance") == 0.05
    assert DEFAULTS.std("wire.resistance") > 1.0
    assert Parameters.of_paper().std("wire.resistance") == 0.05
    assert p.replace(uncertainty={"wire.resistance": 0.001}).std("wire.resistance") == 0.001
    # The table's number is that of one wire: of others it is limited to shares of their value.
    shares = {"wire.resistance": (170.0, 0.01), "wire.diameter": (25e-6, 0.02),
              "wire.mass": (3e-7, 0.02), "wire.surface_area": (8e-6, 0.03),
              "load.force": (0.1, 0.05), "load.stiffness": (5e3, 0.02)}  # fmt: skip
    for name, (value, share) in shares.items():
        assert Parameters({name: value}).std(name) == pytest.approx(share * value)
    assert Parameters({"load.preload": 0.0}).std("load.preload") == 0.2


def test_mass_and_area_that_nobody_stated_are_those_of_the_stated_length_and_diameter():
    wire = Parameters({"wire.length": 0.2, "wire.diameter": 0.15e-3})
    assert wire["wire.mass"] == pytest.approx(22.8e-6, rel=1e-3)
    assert wire["wire.surface_area"] == pytest.approx(94.25e-6, rel=1e-3)
    assert wire.given == {"wire.length", "wire.diameter"}
    assert wire.std("wire.mass") == pytest.approx(0.1 * wire["wire.mass"])
    longer = wire.replace({"wire.length": 0.4, "wire.mass": 30e-6})
    assert longer["wire.mass"] == 30e-6
    assert longer["wire.surface_area"] == pytest.approx(188.5e-6, rel=1e-3)
    assert Parameters({"wire.length": 0.2})["wire.mass"] == DEFAULTS["wire.mass"]
    rod = Parameters({"wire.length": 0.2, "wire.diameter": 5e-3})
    assert rod["wire.mass"] == 0.01  # the end of its range


def test_a_deviation_is_refused_if_negative_or_of_a_limit():
    p = Parameters({"wire.resistance": 2.7})
    assert "expected a standard deviation" in complaint(
        p.replace, uncertainty={"wire.resistance": -1.0}
    )
    assert "has no uncertainty" in complaint(p.std, "bench.maximum_voltage")


ONLY_WITH_OTHERS = ("start_temperature", "finish_temperature", "end_length", "skew", "stiffening")


@settings(max_examples=30)
@given(st.data())
def test_a_written_file_reads_back_the_same(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("round") / "p.yaml"
    chosen = data.draw(st.lists(st.sampled_from(NUMBERS), unique=True, max_size=5))
    chosen = [p for p in chosen if not p.name.endswith(ONLY_WITH_OTHERS)]
    if any(p.name.startswith("effect.slack.") for p in chosen):  # is refused with friction
        chosen = [p for p in chosen if p.name != "load.friction"]
    values = {p.name: data.draw(st.floats(p.low, p.high)) for p in chosen}
    stds = {p.name: data.draw(st.floats(0, 10)) for p in chosen if p.uncertainty is not None}
    original = Parameters(values, stds)
    write_parameters(path, original)
    again = read_parameters(path)
    assert dict(again) == dict(original)
    assert again.given_uncertainty == original.given_uncertainty
    assert again.given - original.given <= {"bench.channels", "bench.channel_sides"}


def test_of_a_nodes_dump_defaults_count_as_unstated_and_numbers_are_those_of_ros(path):
    dump = {p.name: list(p.default) if isinstance(p.default, tuple) else p.default for p in TABLE}
    dump |= {"wire.mass": 1e-4, "wire.specific_heat": 343.2, "uncertainty.wire.specific_heat": 9.0}
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": dump}}))
    assert read_parameters(path).given == {"wire.mass", "wire.specific_heat"}
    write_parameters(path, Parameters({"wire.mass": 1e-4, "bench.maximum_voltage": 8}))
    body = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    assert body["wire"]["mass"] == 1e-4
    assert isinstance(body["wire"]["mass"], float)
    assert isinstance(body["bench"]["maximum_voltage"], float)
    # Nested, flat, and without a decimal point, which YAML reads as text.
    for text in ("wire:\n      mass: 0.0001", "wire.mass: 0.0001", "wire.mass: 1e-4"):
        path.write_text(f"{ROOT}    {text}\n")
        assert read_parameters(path)["wire.mass"] == 1e-4


# Nine maps of nine maps of ...: a kilobyte that took all memory when its names were joined.
NINE = ", ".join(f"k{n}: *b{{0}}" for n in range(9))
MAPS = [f"    b{k}: &b{k} {{{NINE.format(k - 1)}}}\n" for k in range(1, 12)]
BOMB = ROOT + "    b0: &b0 {x: 1.0}\n" + "".join(MAPS)
ILL = [(BOMB, "line 4"), (BOMB, "(*name) are not supported"), (b"\xff\x80", "not a text file")]


def test_a_bad_file_gives_one_line_that_names_it_and_a_good_one_outlives_a_failed_writing(path):
    assert "cannot read" in complaint(read_parameters, path)
    for text, expected in REFUSED["files"] + ILL:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        message = complaint(read_parameters, path)
        assert message.startswith(str(path)) and expected in message
    write_parameters(path, DEFAULTS)
    before = path.read_text()
    folder = path.parent
    assert "cannot write" in complaint(write_parameters, folder / "none" / "p.yaml", DEFAULTS)
    assert path.read_text() == before and os.listdir(folder) == ["p.yaml"]


def test_the_committed_page_is_the_one_the_tables_generate_and_has_every_parameter():
    page = (Path(__file__).resolve().parents[2] / "docs" / "parameters.md").read_text()
    assert page == markdown("parameters"), "run: ./bench parameters --markdown > docs/parameters.md"
    assert [p.name for p in TABLE if f"| `{p.name}` |" not in page] == []


def test_a_written_file_says_unit_range_and_source_and_keeps_what_a_person_wrote(tmp_path):
    first, second = tmp_path / "lab.yaml", tmp_path / "again.yaml"
    write_parameters(first, Parameters({"wire.resistance": 2.8}), "Our lab.", explain=True)
    text = first.read_text()
    assert "      # Electrical resistance of one wire (eq. 3).\n" in text
    assert "      resistance: 2.8  # [ohm] 0.01 to 1000; given\n" in text
    # A default that nobody stated is a comment, and unstated when read again.
    assert "      # specific_heat: 343.2  # [J/(kg K)] 50 to 2000; Table I\n" in text
    assert {"wire.resistance", "wire.specific_heat"} & read_parameters(first).given == {
        "wire.resistance"
    }
    text = text.replace("[ohm] 0.01 to 1000; given", "by Ann, 4 wires")
    limit = "    # no more than the supply gives\n    bench:\n"
    first.write_text("# Bench 2\n" + text.replace("    bench:\n", limit))
    write_parameters(second, read_parameters(first), template=first, explain=True)
    again = second.read_text()
    assert again.startswith("# Bench 2\n# Our lab.\n")
    assert "resistance: 2.8  # by Ann, 4 wires | [ohm] 0.01 to 1000; given\n" in again
    assert limit in again
    write_parameters(first, read_parameters(second), template=second, explain=True)
    assert first.read_text() == again


def test_what_was_identified_is_rounded_to_its_error_and_other_comments_stay(path):
    found = Parameters({"wire.resistance": 2.69871234}, {"wire.resistance": 0.0312345})
    write_parameters(path, found, sources={"wire.resistance": "identified, E1"})
    assert "resistance: 2.699  # [ohm] 0.01 to 1000; identified, E1\n" in path.read_text()
    assert "resistance: 0.031  # [ohm]\n" in path.read_text()
    path.write_text(f"{ROOT}    # clamp meter\n    front: 1.0  # Tuesday\n")
    write_named_values(path, {"front": 2.0, "back": 3.0}, template=path)
    assert "    # clamp meter\n    front: 2.0  # Tuesday\n    back: 3.0\n" in path.read_text()
