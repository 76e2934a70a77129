"""From signs and gains to probabilities, without a fit."""

from types import SimpleNamespace

import pytest

from sma_bench.diagnose.decision import Weights, signs_of_unexplained
from sma_bench.diagnose.left_over import Left

SMOOTH = "a smooth response of free form is left"
BELIEF = "parameters are needed that nobody believes in"


def searched(
    gain, *, beyond=0.0, flexible=0.0, surprise=(10.0, 10.0), sizes=(0.0, 0.0), gap=5.0
):
    """What a search found: gain of the best, and each sign before (recalibrated) and after."""
    return SimpleNamespace(
        off=(), recalibrated=SimpleNamespace(evidence=0.0, surprise=surprise[0]),
        best=SimpleNamespace(evidence=gain, surprise=surprise[1]),
        flexible=SimpleNamespace(gain=flexible), beyond=SimpleNamespace(gain=beyond, gap=gap),
        left=Left(9.0, "deflection", sizes[0], 3.0, 0.0),
        left_by_best=Left(9.0, "deflection", sizes[1], 3.0, 0.0),
    )


@pytest.mark.parametrize(
    ("name", "little", "much"),
    [
        (SMOOTH, {"flexible": 400.0, "beyond": 40.0}, {"flexible": 400.0, "beyond": 300.0}),
        (BELIEF, {"surprise": (900.0, 70.0)}, {"surprise": (90.0, 70.0)}),
        ("deflection scatters more in motion than at rest", {"sizes": (5.0, 0.5)},
         {"sizes": (5.0, 4.0)}),
    ],
)
def test_a_sign_counts_by_the_share_of_it_that_an_effect_leaves(name, little, much):
    assert signs_of_unexplained(searched(30.0, **little))[name] < -2.0
    assert signs_of_unexplained(searched(30.0, **much))[name] > 0.0


def test_a_smooth_response_counts_beside_all_that_was_explained_of_free_form_or_not():
    left = {"flexible": 400.0, "beyond": 300.0}
    assert signs_of_unexplained(searched(30.0, **left))[SMOOTH] > 2.0
    assert signs_of_unexplained(searched(4000.0, **left))[SMOOTH] < -2.0


def test_an_effect_that_leaves_what_was_to_be_explained_is_not_the_cause_whatever_it_gains():
    def unexplained(signs, remains):
        gains = {"slack": 160.0}
        found = Weights(gains, {"slack": 3.0}, {"slack": 0.0}, 5.0, signs, -5.0, remains)
        return found.probabilities()["unexplained"]

    assert unexplained(3.0, remains=3.0) > 0.9
    # An event beside an effect that took the rest away may be a second cause.
    assert 0.3 < unexplained(6.0, remains=-4.0) < 0.5


def test_a_smooth_response_smaller_than_the_noise_says_little_however_sure_it_is():
    told = [signs_of_unexplained(searched(1.0, beyond=36.0, gap=gap))[SMOOTH] for gap in (0.4, 1.2)]
    assert told[0] < 0.0 and told[1] == pytest.approx(3.0, abs=0.1)


def test_a_single_event_and_an_impossible_drift_are_never_weighed_against_what_was_explained():
    search = searched(5000.0)
    search.left_by_best = Left(0.0, "", 0.0, 12.0, 11.0)
    found = signs_of_unexplained(search)
    assert found["a single event stands out"] == pytest.approx(8.0)
    assert found["a sensor would have to drift as none does"] == pytest.approx(6.0)


def test_of_two_pairs_that_gain_much_the_better_one_is_named():
    pairs = {"latent_heat+slack": 2000.0, "residual_strain+slack": 1900.0}
    found = weighed(slack=600.0, latent_heat=9.0, residual_strain=5.0, **pairs)
    assert found["latent_heat+slack"] > 0.9


def weighed(**gains):
    return Weights(
        gains, dict.fromkeys(gains, 3.0), dict.fromkeys(gains, 0.0), 5.0, -5.0, -5.0
    ).probabilities()


def test_an_equation_that_explains_nearly_as_much_stays_a_rival_however_much_that_is():
    close = weighed(stress_dependent_transition=400.0, opposing_wires=380.0)
    assert close["stress_dependent_transition"] < 0.8 < sum(close[n] for n in list(close)[:2])
    far = weighed(stress_dependent_transition=400.0, opposing_wires=300.0)
    assert far["stress_dependent_transition"] > 0.98


def test_what_takes_up_the_same_misfit_in_every_record_must_gain_more_with_each():
    def named(records, gain):
        gains = {"latent_heat": gain}
        found = Weights(
            gains, {"latent_heat": 2.0}, {"latent_heat": 0.0}, 5.0, -5.0, -5.0, records=records
        )
        return found.probabilities()["latent_heat"]

    assert named(1, 9.0) == named(2, 9.0) > 0.6 > named(4, 9.0)
    assert named(4, 18.0) > 0.9


def test_what_gains_here_and_there_counts_as_often_as_it_is_told_and_rivals_stay_as_they_were():
    def found(unsteady, **gains):
        none = dict.fromkeys(gains, 0.0)
        weights = Weights(gains, none, none, 5.0, -5.0, -5.0, unsteady=unsteady)
        return weights.probabilities()

    assert found({}, latent_heat=18.0)["latent_heat"] > 0.9
    assert found({"latent_heat": 5.0}, latent_heat=18.0)["latent_heat"] < 0.5
    # Beside much that is explained, an inexact equation's scatter says nothing against it.
    both = {"latent_heat": 300.0, "slack": 200.0}
    steady, scattered = found({}, **both), found({"latent_heat": 9.0}, **both)
    assert scattered["latent_heat"] == pytest.approx(steady["latent_heat"], abs=0.01)
    assert found({"slack": 5.0}, latent_heat=18.0, slack=9.0)["latent_heat"] > 0.8
