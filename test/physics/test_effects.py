"""Common to all effects: none when off, small when small, finite, convergent in the step."""

import itertools
import shutil
import subprocess
import sys

import effect_references as by_hand
import numpy as np
import pytest
import yaml
from effect_references import COMPOSITE, all_on, on_sides, pulses
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import markdown
from sma_bench.parameters.parameter import declared_effects
from sma_bench.physics import Bench, simulate
from sma_bench.physics.effects import EFFECTS, active_effects

pytest.importorskip("numba", reason="many simulations: slow without numba")

SIGNALS = "temperature martensite_fraction stress contraction bending current deflection"
SIGNALS = (*SIGNALS.split(), "temperature_reading", "deflection_reading")
SCALES = {"temperature_reading": 1.0, "deflection_reading": 1e-3, "current": 0.05}
ALL_PAIRS = list(itertools.combinations(EFFECTS, 2))
CHOSEN = np.random.default_rng(4).choice(len(ALL_PAIRS), 8, replace=False)
SOME = [*((name,) for name in EFFECTS), *(ALL_PAIRS[i] for i in CHOSEN)]


def distance(one, other):
    """Largest difference of readings, each in its own scale."""
    off = {name: np.abs(getattr(other, name) - getattr(one, name)).max() for name in SCALES}
    return max(off[name] / scale for name, scale in SCALES.items())


@pytest.mark.parametrize("switch", by_hand.SWITCHES, ids=lambda p: p.name)
def test_a_small_effect_differs_little_from_none(switch):
    time, voltage = pulses(0.05)
    if switch.name.endswith("return_point"):  # needs nested loops, which the pulses lack
        turns = np.sin(0.5 * np.pi * time) + 0.3 * np.sin(2.0 * np.pi * time / 1.3)
        voltage = np.outer(4.4 + 0.4 * turns, [1.0, 1.0, 0.0, 0.0])
    rig = COMPOSITE.replace(by_hand.SECONDARY)
    baseline = simulate(rig, time, voltage)
    assert active_effects(rig) == ()  # secondary numbers alone switch nothing on
    paper = simulate(COMPOSITE, time, voltage)
    assert all(np.array_equal(getattr(baseline, n), getattr(paper, n)) for n in SIGNALS)
    if switch.name.endswith(("recovery", "tilt")):  # act only with the other part of their effect
        effect = switch.name.split(".")[1]
        rig = by_hand.typical(COMPOSITE, effect).replace({switch.name: 0.0})
        baseline = simulate(rig, time, voltage)
    large, small, tiny = (
        distance(baseline, simulate(rig.replace({switch.name: size}), time, voltage))
        for size in np.array([1e-2, 1e-4, 1e-6]) * switch.uncertainty
    )
    assert large > 0.0
    assert small < 0.03 * large
    assert tiny < 0.03 * small + 1e-7


@pytest.mark.parametrize("names", SOME, ids="+".join)
def test_a_quarter_of_the_step_more_than_halves_the_error(names):
    rig = COMPOSITE
    for name in names:
        rig = by_hand.typical(rig, name)
    time, voltage = pulses(0.02, 12.0)
    run, finer, finest = (simulate(rig, *by_hand.refined(time, voltage, n)) for n in (1, 4, 32))

    def error(coarse, every):
        off = {n: getattr(coarse, n) - getattr(finest, n)[::every] for n in SCALES}
        return max(np.sqrt(np.mean(off[name] ** 2)) / scale for name, scale in SCALES.items())

    assert distance(simulate(COMPOSITE, time, voltage), run) > 0.05
    assert error(run, 32) < 0.3
    assert error(finer, 8) < 0.45 * error(run, 32) + 1e-4


def test_split_and_live_runs_with_all_effects_equal_one_run_to_the_last_bit():
    rig = all_on(COMPOSITE)
    time, voltage = pulses(0.0625)  # exact in binary, so that differences of time are the step
    run = simulate(rig, time, voltage)
    for split in (1, 77, 200, len(time) - 2):
        first = simulate(rig, time[: split + 1], voltage[: split + 1])
        second = simulate(rig, time[split:], voltage[split:], initial=first.final)
        for name in SIGNALS:
            pieces = [getattr(first, name)[:-1], getattr(second, name)]
            assert np.array_equal(np.concatenate(pieces), getattr(run, name)), name
    bench = Bench(rig)
    for k in range(len(time) - 1):
        bench.advance(voltage[k], 0.0625)
        for name in ("temperature", "stress", "contraction", "temperature_reading"):
            assert np.array_equal(getattr(bench, name), getattr(run, name)[k + 1]), (name, k)
        assert np.array_equal(bench.current_at(voltage[k + 1]), run.current[k + 1])
        assert bench.deflection_reading == pytest.approx(run.deflection_reading[k + 1], abs=1e-15)
    assert bench.state.clock == run.clock[-1] == time[-1]


@settings(deadline=None, max_examples=60)
@given(
    st.fixed_dictionaries({
        p.name: st.floats(p.low, p.high)
        for effect in EFFECTS.values() for p in effect.parameters
    }),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.005, 0.05, 1.0]),
    st.sampled_from([("front",), ("back", "front", "back"), ("front", "front", "back", "back")]),
)  # fmt: skip
def test_every_effect_of_any_size_on_any_rig_under_any_voltage_stays_finite(
    values, seed, step, sides
):
    generator = np.random.default_rng(seed)
    voltage = np.repeat(generator.uniform(0.0, 10.0, (40, len(sides))), 5, axis=0)
    voltage[generator.random(200) < 0.2] = 0.0
    rig = on_sides(COMPOSITE, sides).replace(values)
    run = simulate(rig, np.arange(200) * step, voltage)
    for name in SIGNALS:
        assert np.all(np.isfinite(getattr(run, name))), name
    assert np.all((run.martensite_fraction >= 0.0) & (run.martensite_fraction <= 1.0))
    assert np.all(run.temperature > 100.0)


WITHOUT_NUMBA = """
import sys, warnings
import numpy as np
sys.modules["numba"] = None
sys.path.insert(0, sys.argv[2])
from effect_references import all_on, on_sides, pulses
from sma_bench.parameters import Parameters
rig = all_on(on_sides(Parameters.of_paper(), ("front", "back", "front")))
time, voltage = pulses(0.1, 10.0)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from sma_bench.physics import simulate
    simulate(rig, time[:2], voltage[:2, :3])
    run = simulate(rig, time, 1.4 * voltage[:, :3])
print(len([w for w in caught if "numba" in str(w.message)]))
np.save(sys.argv[1], np.hstack([run.temperature, run.martensite_fraction, run.stress / 1e9,
                                run.bending, run.temperature_reading]))
"""


def test_without_numba_all_effects_give_the_same_and_one_warning(tmp_path, pytestconfig):
    file, here = tmp_path / "plain.npy", pytestconfig.rootpath / "test" / "physics"
    plain = subprocess.run([sys.executable, "-c", WITHOUT_NUMBA, str(file), str(here)], check=True,
                           cwd=pytestconfig.rootpath, timeout=300, capture_output=True,
                           text=True)  # fmt: skip
    assert plain.stdout.strip() == "1"
    rig = all_on(on_sides(Parameters.of_paper(), ("front", "back", "front")))
    time, voltage = pulses(0.1, 10.0)
    run = simulate(rig, time, 1.4 * voltage[:, :3])
    assert np.ptp(run.martensite_fraction) > 0.5
    compiled = np.hstack([run.temperature, run.martensite_fraction, run.stress / 1e9, run.bending,
                          run.temperature_reading])  # fmt: skip
    assert np.load(file) == pytest.approx(compiled, rel=1e-9, abs=1e-9)


def test_the_committed_page_of_effects_is_up_to_date(pytestconfig):
    page = markdown("effects")
    committed = (pytestconfig.rootpath / "docs" / "effects.md").read_text()
    assert committed == page, "run: ./bench effects --markdown > docs/effects.md"
    for effect in EFFECTS.values():
        assert f"## `{effect.name}`\n" in page and effect.shows in page
        assert all(f"`{p.name}`" in page for p in effect.parameters)


MADE_UP = '''# mypy: disallow-untyped-defs=False
"""Wires that shrink a little every second, e = s n. Source: made up."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

@borrowing
def added_strain(wires, i):
    return wires[i, at.SHRUNK]

@borrowing
def after_step(wires, i, fraction_before, step):
    wires[i, at.SHRUNK] += wires[i, at.SHRINKING] * step
'''
ENTRY = """
made_up:
  stage: mechanical
  shows: the beam bends all by itself
  acts_on: [deflection]
  marks: [EVOLVES]
  parameters:
    rate: {unit: 1/s, validation: {bounds<>: [0.0, 0.01]}, uncertainty: 0.001,
      description: Contraction a second., source: made up}
  columns: {rate: SHRINKING}
  state: [SHRUNK]
"""
WITH_MADE_UP = """
import sys
from sma_bench.parameters import Parameters, node_tables, read_parameters
assert "numba" not in sys.modules, "reading parameters loads the compiler"
assert "## `made_up`" in node_tables.markdown("effects")
rig = read_parameters(sys.argv[1])
sys.modules["numba"] = None
import numpy as np
from sma_bench.physics import material, simulate
time = np.arange(101) * 0.1
run = simulate(rig, time, np.zeros(101))
assert abs(run.stress[-1, 0] - 22.8e9 * 1e-3 * time[-2]) < 1.0, run.stress[-1]
assert not simulate(Parameters.of_paper(), time, np.zeros(101)).stress.any()
"""


def test_a_new_effect_is_one_file_and_one_entry(tmp_path, pytestconfig):
    package = tmp_path / "sma_bench"
    leave = shutil.ignore_patterns("__pycache__", "*.html", "__init__.py")
    shutil.copytree(pytestconfig.rootpath / "sma_bench", package, ignore=leave)
    for room in ("parameters", "physics", "physics/effects", "physics/laws"):
        shutil.copy(pytestconfig.rootpath / "sma_bench" / room / "__init__.py", package / room)
    (package / "__init__.py").touch()
    (package / "physics" / "effects" / "made_up.py").write_text(MADE_UP)
    with (package / "parameters" / "effects.yaml").open("a") as entries:
        entries.write(ENTRY)
    file = tmp_path / "rig.yaml"
    file.write_text("/**: {ros__parameters: {effect: {made_up: {rate: 1.0e-3}}}}")
    command = [sys.executable, "-W", "ignore", "-c", WITH_MADE_UP, str(file)]
    subprocess.run(command, check=True, cwd=tmp_path, timeout=120)


LACKS = "effect made_up: expected an entry in effects.yaml and a docstring in .*.py"


@pytest.mark.parametrize(("file", "entry", "message"), [
    (MADE_UP, "{}", LACKS), ("", ENTRY, LACKS), ("pass", ENTRY, LACKS),
    (MADE_UP, ENTRY.replace("stage: mechanical", ""), "made_up: missing or unknown: .* 'stage'"),
    (MADE_UP, ENTRY.replace("mechanical", "electric"), "made_up: missing or unknown: 'electric'"),
    (MADE_UP, ENTRY.replace("shows", "display"), "made_up: missing or unknown: .* 'display'"),
    (MADE_UP, ENTRY.replace("source", "form"), "made_up: missing or unknown: 'source'"),
])  # fmt: skip
def test_a_broken_declaration_is_refused_with_the_effects_name(tmp_path, file, entry, message):
    if file:
        (tmp_path / "made_up.py").write_text(file)
    with pytest.raises(ValueError, match=message) as error:
        declared_effects(yaml.safe_load(entry), tmp_path)
    assert "\n" not in str(error.value)
