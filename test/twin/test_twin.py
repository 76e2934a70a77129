"""The twin beside a synthetic bench: verdicts with an effect, with none, and on faulty streams."""

import math

import numpy as np
import pytest
from planted import LOADS, ONE_WIRE, true_bench
from scipy.signal import lfilter

from examination.check import twin_alarms
from sma_bench.errors import InputError
from sma_bench.live.virtual_bench import VirtualBench
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.twin.twin import CURRENT, GAP, GREW, LEARNING, NANOSECONDS, QUIET, TEMPERATURE, Twin

RATE = 20.0  # Hz
RATES = {f"rate.{kind}": RATE for kind in ("power", "temperature", "mechanics")}
SIMULATOR = {p.name: p.default for p in NODE_TABLES["simulator"]} | RATES
SETTINGS = {p.name: p.default for p in NODE_TABLES["twin"]}
EPOCH = 1_700_000_000 * NANOSECONDS
SLICE = 0.05  # s
REST, PULSE = 7.0, 8.0  # s
BENCH = true_bench({})
COUPLED = BENCH.replace({"effect.side_heat_coupling.conductance": 0.002})
CLAMPED = Parameters.of_paper().replace({"wire.martensite_start_temperature": 345.0})
SOUND = "no gap beyond the noise"


def by_turns(time):
    """V: a rest, then front and back by turns."""
    if time < REST:
        return 0.0, 0.0
    return [(2.0, 0.0), (0.0, 0.0), (0.0, 2.0), (1.6, 0.0)][int((time - REST) / PULSE) % 4]


def one_wire(time):
    return (0.0 if time < REST else 2.5 * (1.0 - abs((time - REST) / 10.0 % 2.0 - 1.0)),)


def at_rest(time):
    return 0.0, 0.0


class Stream:
    """A bench with its own clock and a twin; `spoil` changes readings on their way to the twin.

    `verdicts` are those of the twin, in the order of time.
    """

    def __init__(self, truth, belief=BENCH, drive=by_turns, spoil=None, **simulator):
        self.bench = VirtualBench(truth, SIMULATOR | simulator)
        self.predictions, self.residuals, self.verdicts = [], [], []
        self.twin = Twin(belief, SETTINGS, self.predictions.append, self.residuals.append)
        self.drive, self.spoil = drive, spoil or (lambda kind, time, values: values)
        self.time, self.shift = 0.0, 0.0

    def run(self, seconds, heard=True):
        for _ in range(round(seconds / SLICE)):
            until = round((self.time + SLICE) * NANOSECONDS)
            for reading in self.bench.advance(tuple(self.drive(self.time)), until):
                if heard:
                    self.tell(reading)
            self.time = round(self.time + SLICE, 6)
            if round(self.time / SLICE) % 4 == 0:
                self.twin.advance()
                self.verdicts.append(self.twin.verdict)
        return self.twin.verdict

    def tell(self, reading):
        stamp = EPOCH + reading.time + round(self.shift * NANOSECONDS)
        values = self.spoil(reading.kind, reading.time / NANOSECONDS, reading.values)
        if reading.kind == "power":
            for wire, (volt, ampere) in enumerate(values):
                self.twin.power(wire, stamp, volt, ampere)
        elif reading.kind == "temperature":
            for wire, celsius in enumerate(values):
                self.twin.temperature(wire, stamp, celsius + 273.15)
        elif reading.kind == "mechanics":
            first, second = values
            if self.bench.composite:
                self.twin.mechanics(stamp, 0.5 * (second - first))
            else:
                self.twin.mechanics(stamp, first if self.bench.moves else second)

    def states(self):
        return {verdict.state for verdict in self.verdicts}

    def grown(self):
        """Stages of each verdict that reports a grown gap."""
        return [verdict.stages for verdict in self.verdicts if verdict.state == GREW]


def coloured(memory):
    """Adds noise of a thermometer with a correlation time of so many seconds."""
    random, phi = np.random.default_rng(5), math.exp(-1.0 / (RATE * memory))
    drawn = random.standard_normal((4000, 2)) * 0.4 * math.sqrt(1.0 - phi**2)
    noise = iter(lfilter([1.0], [1.0, -phi], drawn, axis=0))
    return lambda kind, _, v: list(np.array(v) + next(noise)) if kind == "temperature" else v


def no_numbers(kind, time, values):
    """NaN or infinity, five times a second."""
    if round(time * 1000) % 200:
        return values
    if kind == "power":
        return [(math.nan, math.nan), (values[1][0], math.nan)]
    return [math.nan if kind == "temperature" else math.inf for _ in values]


def blind(kind, _, values):
    return [] if kind == "temperature" else values


@pytest.mark.parametrize(("bench", "drive", "late", "seconds", "spoil", "message"), [
    (BENCH, by_turns, 0.0, 40.0, None, SOUND),
    (CLAMPED, one_wire, 0.0, 30.0, None, SOUND),
    (BENCH, by_turns, 10.5, 30.0, None, SOUND),  # joins in a pulse
    (BENCH, by_turns, 0.0, 40.0, coloured(0.3), None),
    (BENCH, by_turns, 0.0, 40.0, no_numbers, None),
    (BENCH, by_turns, 0.0, 40.0, blind, f"{SOUND}; not judged: thermal"),
])  # fmt: skip
def test_a_bench_that_follows_the_model_never_has_a_gap(
    bench, drive, late, seconds, spoil, message
):
    stream = Stream(bench, bench, drive, spoil, seed=0 if spoil or late else 2)
    stream.run(late, heard=False)
    verdict = stream.run(seconds)
    assert stream.states() == {LEARNING, QUIET}
    assert message is None or verdict.message == message
    if not (spoil or late):
        assert [s.stage for s in verdict.measured][-3:] == ["electrical", "thermal", "mechanical"]
        assert all(0.5 < s.energy < 2.0 for s in verdict.measured)
    if late:  # begins at the measured temperatures
        measured = next(r for r in stream.residuals if r.kind == TEMPERATURE)
        assert abs(measured.value) < 5.0
        assert stream.predictions[0].temperature.max() > 300.0
    if spoil is no_numbers:
        assert verdict.state == QUIET
        names = ("voltages_not_a_number", "readings_not_usable", "restarts")
        assert [stream.twin.counts[name] for name in names] == [200, 600, 0]


@pytest.mark.parametrize(("load", "supply"), [("force", {"bench.drive": "duty"}),
                                              ("antagonist", {})])  # fmt: skip
def test_wires_with_a_load_have_a_gap_only_with_an_effect(load, supply):
    rig = BENCH if load == "antagonist" else BENCH.replace(ONE_WIRE)
    belief = rig.replace({"load.kind": load, **LOADS[load], **supply})
    spoilt = belief.replace({"effect.residual_strain.share": 0.2})

    def drive(time):
        volts = [1.2 * volt for volt in (by_turns if load == "antagonist" else one_wire)(time)]
        return [v**2 / 10.0 if load == "force" else v for v in volts]  # a duty of 10 V

    quiet, grown = Stream(belief, belief, drive), Stream(spoilt, belief, drive)
    quiet.run(40.0)
    grown.run(40.0)
    assert quiet.states() == {LEARNING, QUIET}
    assert set(grown.grown()) == {("mechanical",)}


DRIFT = {"effect.transition_drift.shift": -12.0, "effect.transition_drift.cycles": 0.2}


@pytest.mark.parametrize(("effect", "expected"), [
    ({"effect.side_heat_coupling.conductance": 0.002}, "thermal"),
    ({"effect.supply_drop.resistance": 0.3}, "electrical"),
    (DRIFT, "mechanical"),
    ({"effect.temperature_underfill.missing": 0.15}, "sensor"),
], ids="".join)  # fmt: skip
def test_a_hidden_effect_is_a_gap_that_grew_in_its_stage(effect, expected):
    stream = Stream(BENCH.replace(effect))
    stream.run(7.0 + 4.5 * PULSE)
    named = stream.grown()
    assert named and named[-1] == (expected,)
    # A thermometer that reads low shows as such once the wires begin to pull.
    before = {"thermal"} if expected == "sensor" else set()
    assert {s for stages in named for s in stages} - before == {expected}


def test_predictions_of_the_twin_equal_the_bench_without_noise():
    exact = {"sensor.voltage_noise": 0.0, "sensor.voltage_resolution": 0.0}
    stream = Stream(BENCH, **exact)
    stream.run(20.0)
    for kind, sensor in ((TEMPERATURE, "temperature"), (CURRENT, "current")):
        found = [r.value for r in stream.residuals if r.kind == kind]
        noise, step = (SIMULATOR[f"sensor.{sensor}_{what}"] for what in ("noise", "resolution"))
        assert np.std(found) == pytest.approx(math.hypot(noise, step / math.sqrt(12.0)), rel=0.15)
        assert kind == CURRENT or abs(np.mean(found)) < 0.05
    driven = next(p for p in stream.predictions if p.stamp == EPOCH + 10 * NANOSECONDS)
    assert driven.voltage == pytest.approx([2.0, 0.0], abs=0.02)
    assert driven.temperature[0] > driven.temperature[1] + 30.0


def test_a_change_of_parameters_also_re_simulates_the_past_and_ends_the_gap():
    """And a gap that was accepted as known has not grown."""
    stream, knowing = Stream(COUPLED), Stream(COUPLED, COUPLED)
    assert stream.run(30.0).state == GREW
    stream.twin.accept()
    assert stream.run(3.0).state == GAP
    knowing.run(33.0)
    stream.twin.change(COUPLED)
    assert stream.twin.verdict.state == LEARNING
    stream.run(0.5)
    knowing.run(0.5)
    last, reference = stream.predictions[-1], knowing.predictions[-1]
    assert last.stamp == reference.stamp
    assert last.temperature == pytest.approx(reference.temperature, abs=1e-9)
    assert last.mechanics == pytest.approx(reference.mechanics, abs=1e-12)
    stream.verdicts.clear()
    assert stream.run(20.0).state == QUIET
    assert stream.states() == {LEARNING, QUIET}


def test_a_gap_from_the_start_is_known():
    stream = Stream(COUPLED, drive=lambda _: (1.5, 0.0))
    stream.run(30.0)
    assert GREW not in stream.states()
    assert stream.verdicts[-1].message.startswith("known gap: thermal stage")


def test_the_twin_restarts_after_gaps_in_time_jumps_and_looped_records():
    stream, again = Stream(BENCH), Stream(BENCH)
    stream.run(12.0)
    stream.run(3.0, heard=False)
    stream.run(20.0)
    assert stream.twin.restarts == 1 and stream.twin.reason == "no voltages for 3.05 s"
    stream.shift = 5000.0
    assert stream.run(20.0).state == QUIET
    assert stream.twin.restarts == 2 and stream.states() == {LEARNING, QUIET}
    # Played twice, as by a looping player: in the second round the bench is cold again.
    again.twin = stream.twin
    assert again.run(20.0).state == QUIET
    assert stream.twin.restarts == 3 and again.states() == {LEARNING, QUIET}
    assert stream.twin.reason.startswith("time went back by")


def test_missing_voltages_are_awaited_and_missing_temperatures_leave_the_stage_open():
    stream = Stream(BENCH, spoil=lambda kind, _, v: v[:1] if kind == "power" else v)
    assert stream.run(10.0).message == "learning: waiting for voltage of back_1"
    assert not stream.predictions
    stream = Stream(BENCH.replace({"effect.side_asymmetry.ratio": 0.3}), spoil=blind)
    open_stage = "gap grew: thermal or mechanical stage (wires without temperatures)"
    assert stream.run(30.0).message.startswith(open_stage)


def test_the_stated_uncertainty_of_a_reading_is_taken_into_account():
    """A camera does not see a cold wire: it reads the background, within 1.6 K."""

    def off(kind, time, values):
        return [v + 1.05 for v in values] if kind == "temperature" and time > 8.0 else values

    silent, telling = (Stream(BENCH, drive=at_rest, spoil=off) for _ in range(2))
    assert silent.run(20.0).state == GREW
    hear = telling.twin.temperature
    telling.twin.temperature = lambda *reading: hear(*reading, 1.64)
    assert telling.run(20.0).state == QUIET
    assert telling.states() == {LEARNING, QUIET}


def test_noise_that_a_sensor_may_have_is_no_gap_and_a_step_beyond_it_is_one_soon():
    """Hours of a drifting thermometer; `./bench check twin_alarms` draws weeks of it."""
    random = np.random.default_rng(7)
    allowed = twin_alarms.ALLOWED
    for time in (3.0, 30.0, 200.0):
        residual = twin_alarms.residuals(random, 50_000, allowed, time)
        largest = list(twin_alarms.excursions(residual))
        assert largest and max(largest) < twin_alarms.SURPRISING
    delay = twin_alarms.delays(random, 2.0, 0.5 * allowed, 30.0, trials=5)
    assert (delay < 10.0).all()


def test_rates_and_timeout_may_change_while_the_twin_runs():
    stream = Stream(CLAMPED, CLAMPED, one_wire)
    stream.run(3.0)
    often = len(stream.predictions)
    stream.twin.tune(SETTINGS | {"publish_rate": 5.0, "voltage_timeout": 3.0})
    stream.run(3.0)
    assert 12 < len(stream.predictions) - often < 18 < 0.5 * often
    for timeout, restarts in ((3.0, 0), (0.5, 1)):
        stream.twin.tune(SETTINGS | {"voltage_timeout": timeout})
        stream.run(1.0, heard=False)
        stream.run(1.0)
        assert stream.twin.restarts == restarts


def test_a_twin_refuses_a_load_with_imposed_motion():
    with pytest.raises(InputError, match="twin: load.kind is displacement, expected a load"):
        Stream(CLAMPED, CLAMPED.replace({"load.kind": "displacement"}))


def test_the_band_contains_a_bench_within_the_uncertainties():
    unsure = {"wire.resistance": 0.02, "wire.heat_transfer_coefficient": 12.0,
              "wire.maximum_recoverable_strain": 0.0015}  # fmt: skip
    truth = BENCH.replace({name: BENCH[name] + std for name, std in unsure.items()})
    streams = [Stream(truth, BENCH.replace({}, unsure)), Stream(truth, truth)]
    for stream, share in zip(streams, (0.9, 0.0), strict=True):
        stream.twin.tune(SETTINGS | {"band": share})
        stream.run(40.0)
    banded, true = (stream.predictions for stream in streams)
    first = next(k for k, one in enumerate(banded) if one.off) + 100
    for quantity in ("current", "temperature", "mechanics"):
        predicted, there, off = (
            np.array([getattr(one, quantity) for one in some])
            for some in (banded[first:], true[first:], [one.off for one in banded[first:]])
        )
        miss = np.abs(there - predicted)
        assert np.mean(miss <= off) > 0.8 and np.max(miss) > 0.2 * np.max(off) > 0.0
    assert not any(one.off for one in true)
    sure = dict.fromkeys(BENCH.given_uncertainty, 0.0)
    streams[0].twin.change(BENCH.replace({}, sure))  # no band, and why
    assert "uncertainty" in streams[0].twin.no_band
    streams[0].run(1.0)
    assert banded[-1].off is None
