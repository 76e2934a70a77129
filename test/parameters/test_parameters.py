"""Validation of parameters, and ROS parameter files in and out."""

import os
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.parameters import TABLE, Parameters, read_parameters, write_parameters
from sma_bench.parameters.documentation import parameter_page
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.table import BY_NAME
from sma_bench.parameters.yaml_file import write_named_values

NUMBERS = [p for p in TABLE if p.kind == "double"]


def write(tmp_path, text):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    return path


def complaint(call, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        call(*args, **kwargs)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_defaults_are_the_papers_table_one():
    p = Parameters.defaults()
    table_one = {
        "wire.resistance": 2.6987, "wire.heat_transfer_coefficient": 403.26,
        "wire.specific_heat": 343.2, "wire.mass": 0.091e-3, "wire.surface_area": 395.84e-6,
        "environment.ambient_temperature": 296.15,
    }
    assert {name: p[name] for name in table_one} == table_one


@pytest.mark.parametrize("parameter", TABLE, ids=lambda p: p.name)
def test_every_declaration_is_complete_and_holds_its_own_default(parameter):
    assert parameter.description.endswith(".")
    assert parameter.provenance
    assert parameter.validated(parameter.default) == parameter.default
    if parameter.kind == "double":
        assert parameter.unit and parameter.low is not None and parameter.high is not None


def test_unknown_name_is_refused_with_the_nearest_one():
    message = complaint(Parameters.defaults().replace, {"wire.resistence": 2.0})
    assert "unknown parameter wire.resistence, did you mean wire.resistance?" in message


def test_celsius_in_a_kelvin_parameter_is_recognised():
    message = complaint(Parameters, {"environment.ambient_temperature": 23.0})
    assert "environment.ambient_temperature is 23 K" in message
    assert "degrees Celsius" in message


@pytest.mark.parametrize("value", ["2.7 ohm", None, True, [2.7], {"a": 1}])
def test_a_value_that_is_no_number_is_refused_with_its_unit(value):
    assert "expected a number in ohm" in complaint(Parameters, {"wire.resistance": value})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_value_that_is_not_finite_is_refused(value):
    assert "expected a finite number" in complaint(Parameters, {"wire.resistance": value})


def test_a_transition_that_ends_before_it_starts_is_refused():
    start, finish = "wire.austenite_start_temperature", "wire.austenite_finish_temperature"
    message = complaint(Parameters, {start: 360.0, finish: 355.0})
    assert f"{start} 360 K must lie below" in message
    # What nobody stated makes way.
    assert Parameters({start: 360.0})[finish] == pytest.approx(381.8)
    assert Parameters({finish: 330.0})[start] == pytest.approx(308.2)


def test_channels_and_sides_must_pair_up():
    message = complaint(Parameters, {"bench.channels": ["a", "b"]})
    assert "bench.channel_sides has 1 entries, expected 2" in message


def test_a_deviation_is_the_stated_one_else_the_tables_of_a_stated_value_else_that_of_the_field():
    p = Parameters({"wire.resistance": 2.7})
    assert p.std("wire.resistance") == 0.05
    assert Parameters.defaults().std("wire.resistance") > 1.0
    assert Parameters.of_paper().std("wire.resistance") == 0.05
    assert p.replace(uncertainty={"wire.resistance": 0.001}).std("wire.resistance") == 0.001
    assert "expected a standard deviation" in complaint(
        p.replace, uncertainty={"wire.resistance": -1.0}
    )
    assert "has no uncertainty" in complaint(p.std, "bench.maximum_voltage")


@given(st.data())
def test_a_written_file_reads_back_the_same(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("round") / "p.yaml"
    chosen = data.draw(st.lists(st.sampled_from(NUMBERS), unique=True, max_size=5))
    values = {
        p.name: data.draw(st.floats(p.low, p.high))
        for p in chosen
        if not p.name.endswith(("start_temperature", "finish_temperature"))
    }
    stds = {
        name: data.draw(st.floats(0, 10))
        for name in values if BY_NAME[name].uncertainty is not None
    }
    original = Parameters(values, stds)
    write_parameters(path, original)
    again = read_parameters(path)
    assert dict(again) == dict(original)
    assert again.given_uncertainty == original.given_uncertainty
    assert again.given - original.given <= {"bench.channels", "bench.channel_sides"}


def test_a_default_that_nobody_stated_is_written_as_a_comment(tmp_path):
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    write_parameters(first, Parameters({"wire.mass": 1e-4}), explain=True)
    again = read_parameters(first)
    assert "wire.mass" in again.given and "wire.resistance" not in again.given
    assert "      # resistance: 2.6987" in first.read_text()
    write_parameters(second, again, template=first, explain=True)
    assert second.read_text() == first.read_text()


def test_of_a_nodes_dump_defaults_count_as_unstated(tmp_path):
    dump = {p.name: list(p.default) if isinstance(p.default, tuple) else p.default for p in TABLE}
    dump |= {"wire.mass": 1e-4, "wire.specific_heat": 343.2, "uncertainty.wire.specific_heat": 9.0}
    path = tmp_path / "dump.yaml"
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": dump}}))
    assert read_parameters(path).given == {"wire.mass", "wire.specific_heat"}


def test_numbers_are_written_as_ros_reads_doubles(tmp_path):
    path = tmp_path / "p.yaml"
    write_parameters(path, Parameters({"wire.mass": 1e-4, "bench.maximum_voltage": 8}))
    body = yaml.safe_load(path.read_text())["/**"]["ros__parameters"]
    assert body["wire"]["mass"] == 1e-4 and isinstance(body["wire"]["mass"], float)
    assert isinstance(body["bench"]["maximum_voltage"], float)


def test_flat_and_nested_names_are_the_same(tmp_path):
    nested = write(tmp_path, "/**:\n  ros__parameters:\n    wire:\n      resistance: 3.0\n")
    assert read_parameters(nested)["wire.resistance"] == 3.0
    flat = write(tmp_path, "/**:\n  ros__parameters:\n    wire.resistance: 3.0\n")
    assert read_parameters(flat)["wire.resistance"] == 3.0


def test_a_number_without_a_decimal_point_but_an_exponent_is_a_number_as_in_ros(tmp_path):
    path = write(tmp_path, "/**:\n  ros__parameters:\n    wire.mass: 1e-4\n")
    assert read_parameters(path)["wire.mass"] == 1e-4


@pytest.mark.parametrize(
    "text, expected",
    [
        ("simulator:\n  ros__parameters:\n    wire.mass: 1e-4\n", "no '/**: ros__parameters:'"),
        ("/**:\n  wire.mass: 1e-4\n", "expected a ros__parameters mapping"),
        ("a: [1\n", "not YAML"),
        ("just text\n", "expected a ROS parameter file"),
        ("/**:\n  ros__parameters:\n    wire.resistance: 2.7 ohm\n", "expected a number in ohm"),
        ("/**:\n  ros__parameters:\n    wirre.resistance: 2.7\n", "unknown parameter"),
    ],
)
def test_a_bad_file_gives_one_line_that_names_it(tmp_path, text, expected):
    path = write(tmp_path, text)
    message = complaint(read_parameters, path)
    assert message.startswith(str(path)) and expected in message


def test_a_file_that_is_not_there_or_not_text_gives_one_line(tmp_path):
    assert "cannot read" in complaint(read_parameters, tmp_path / "none.yaml")
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    assert "not a text file" in complaint(read_parameters, binary)


def test_a_folder_that_cannot_be_written_leaves_the_good_file_alone(tmp_path):
    good = tmp_path / "good.yaml"
    write_parameters(good, Parameters.defaults())
    before = good.read_text()
    message = complaint(write_parameters, tmp_path / "none" / "p.yaml", Parameters.defaults())
    assert "cannot write" in message
    assert good.read_text() == before
    assert os.listdir(tmp_path) == ["good.yaml"]


def test_the_page_documents_every_parameter():
    page = parameter_page({})
    assert [p.name for p in TABLE if f"| `{p.name}` |" not in page] == []


def test_the_committed_page_is_the_one_the_tables_generate():
    page = Path(__file__).resolve().parents[2] / "docs" / "parameters.md"
    assert page.read_text() == parameter_page(NODE_TABLES), (
        "run: ./bench parameters --markdown > docs/parameters.md"
    )


def test_aliases_are_refused_as_ros_refuses_them(tmp_path):
    """Nine maps of nine maps of ...: a kilobyte that took all memory when its names were joined."""
    bomb = "    b0: &b0 {x: 1.0}\n" + "".join(
        f"    b{k}: &b{k} {{{', '.join(f'k{n}: *b{k - 1}' for n in range(9))}}}\n"
        for k in range(1, 12)
    )
    path = tmp_path / "bomb.yaml"
    path.write_text("/**:\n  ros__parameters:\n" + bomb)
    message = complaint(read_parameters, path)
    assert "line 4" in message and "aliases (*name) are not taken" in message


def test_a_written_file_says_unit_range_and_source_and_keeps_what_a_person_wrote(tmp_path):
    first, second = tmp_path / "lab.yaml", tmp_path / "again.yaml"
    write_parameters(first, Parameters({"wire.resistance": 2.8}), "Our lab.", explain=True)
    text = first.read_text()
    assert "      # Electrical resistance of one wire (eq. 3).\n" in text
    assert "      resistance: 2.8  # [ohm] 0.01 to 1000; given\n" in text
    assert "      # specific_heat: 343.2  # [J/(kg K)] 50 to 2000; Table I\n" in text
    text = text.replace("[ohm] 0.01 to 1000; given", "by Ann, 4 wires")
    limit = "    # no more than the supply gives\n    bench:\n"
    text = "# Bench 2\n" + text.replace("    bench:\n", limit)
    first.write_text(text)
    write_parameters(second, read_parameters(first), template=first, explain=True)
    again = second.read_text()
    assert again.startswith("# Bench 2\n# Our lab.\n")
    assert "resistance: 2.8  # by Ann, 4 wires | [ohm] 0.01 to 1000; given\n" in again
    assert limit in again
    write_parameters(first, read_parameters(second), template=second, explain=True)
    assert first.read_text() == again


def test_what_was_identified_is_rounded_to_the_second_digit_of_its_error(tmp_path):
    found = Parameters({"wire.resistance": 2.69871234}, {"wire.resistance": 0.0312345})
    write_parameters(tmp_path / "p.yaml", found, sources={"wire.resistance": "identified, E1"})
    text = (tmp_path / "p.yaml").read_text()
    assert "resistance: 2.699  # [ohm] 0.01 to 1000; identified, E1\n" in text
    assert "resistance: 0.031  # [ohm]\n" in text


def test_values_written_by_name_leave_the_comments_of_their_file(tmp_path):
    kept = "    # clamp meter\n    front: 1.0  # Tuesday\n"
    path = write(tmp_path, f"/**:\n  ros__parameters:\n{kept}")
    write_named_values(path, {"front": 2.0, "back": 3.0})
    assert "    # clamp meter\n    front: 2.0  # Tuesday\n    back: 3.0\n" in path.read_text()
