"""Launch and parameter files: they are valid, and the launch files start what they should."""

import ast
import importlib.util
from pathlib import Path

import pytest

from sma_bench.parameters import Parameters, read_parameters
from sma_bench.protocols import load_protocol

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))


def test_both_rigs_have_a_launch_file():
    names = [path.name for path in LAUNCH_FILES]
    assert names == ["composite_bench.launch.py", "wire_bench.launch.py"]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_a_launch_file_names_an_existing_rig_and_an_existing_protocol(path):
    assigned = {
        statement.targets[0].id: statement.value
        for statement in ast.parse(path.read_text()).body
        if isinstance(statement, ast.Assign)
    }
    rig = read_parameters(ROOT / "config" / assigned["RIG"].value)
    arguments = dict(zip(
        (key.value for key in assigned["ARGUMENTS"].keys), assigned["ARGUMENTS"].values,
        strict=True,
    ))
    protocol = arguments["protocol"].elts[0].value
    assert load_protocol(protocol, rig).channels == rig["bench.channels"]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_a_launch_file_starts_the_four_nodes(path, monkeypatch):
    for package in ("launch", "launch_ros", "ament_index_python"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    from ament_index_python import packages
    from launch_ros.actions import Node

    monkeypatch.setattr(packages, "get_package_share_directory", lambda _: str(ROOT))
    spec = importlib.util.spec_from_file_location("launch_file", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    entities = module.generate_launch_description().entities
    executables = [entity.node_executable for entity in entities if isinstance(entity, Node)]
    assert executables == ["simulator", "experiment", "recorder", "identification"]


@pytest.mark.parametrize("rig", ["wire_rig", "composite_rig"])
def test_a_rig_file_carries_table_i_and_differs_from_the_table_in_its_channels_only(rig):
    parameters = read_parameters(ROOT / "config" / f"{rig}.yaml")
    defaults = Parameters.defaults()
    different = {name for name in defaults if parameters[name] != defaults[name]}
    assert different <= {"bench.channels", "bench.channel_sides"}
    assert {"wire.resistance", "wire.specific_heat"} <= parameters.given


@pytest.mark.parametrize("rig", ["wire_rig", "composite_rig"])
def test_every_number_of_a_rig_file_is_a_double_to_ros(rig):
    import yaml

    body = yaml.safe_load((ROOT / "config" / f"{rig}.yaml").read_text())["/**"]["ros__parameters"]
    numbers = [value for group in body.values() for value in group.values()]
    assert all(isinstance(value, (float, list)) for value in numbers)
