"""docs/tutorials/rest_deflection.md, played as it is written."""

import json
import shlex

import pytest

from sma_bench import compiled
from sma_bench.cli import main

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(compiled.numba is None, reason="diagnoses take minutes uncompiled"),
]


@pytest.fixture(scope="module")
def played(pytestconfig, tmp_path_factory):
    """Results of the page's diagnoses, in its order, by record and whether all signals count."""
    root = pytestconfig.rootpath
    folder = tmp_path_factory.mktemp("tutorial")
    results = {}
    page = (root / "docs" / "tutorials" / "rest_deflection.md").read_text()
    for line in page.splitlines():
        if line.startswith("cd "):
            folder /= line.removeprefix("cd ")
        if not line.startswith("sma-bench "):
            continue
        words = shlex.split(line)[1:]
        made = ("strained", "coupled", "lab.yaml", "rest_deflection")
        words = [str(folder / w) if w in made else w for w in words]
        if words[0] == "diagnose":
            file = folder / f"{len(results)}.json"
            assert main([*words, "--json", str(file)]) == 0
            name = words[1].rpartition("/")[2]
            results[name, "--signals" not in words] = json.loads(file.read_text())
        else:
            assert main(words) == 0
    return results


@pytest.mark.parametrize("with_camera", [False, True])
def test_residual_strain_shows_at_rest_in_either_record(played, with_camera):
    assert set(played) == {(n, a) for n in ("strained", "coupled") for a in (False, True)}
    answer = played["strained", with_camera]
    assert answer["cause"] == ["residual_strain"]
    assert answer["where"]["phase"] == "rest"


def test_heat_coupling_hides_in_the_parameters_without_a_camera(played):
    answer = played["coupled", False]
    assert answer["verdict"] == "recalibration"
    assert answer["where"]["phase"] == "drive"


def test_the_camera_tells_heat_coupling(played):
    answer = played["coupled", True]
    assert answer["cause"] == ["side_heat_coupling"]
    found = {c["name"]: c["log_evidence"] for c in answer["candidates"]}
    assert found["side_heat_coupling"] > 1000.0
    chain = {link["block"]: link["gap"] for link in answer["where"]["chain"]}
    assert chain["V -> temperature"] > 3.0
    # The residual strain acts after the temperature.
    chain = {link["block"]: link["gap"] for link in played["strained", True]["where"]["chain"]}
    assert chain["V -> temperature"] < 1.0
    assert 0.5 < chain["temperature -> deflection"] / chain["V -> deflection"] < 2.0
