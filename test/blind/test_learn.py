"""The decision's weights: the likeliest for the cases, those of the package for what is stored."""

import gzip
from types import SimpleNamespace

import numpy as np
import pytest

from examination.blind import learn
from examination.blind.learn import STORED, conformal, credible, fit_weights, right_names
from sma_bench.diagnose.decision import NAMES, learnt

GAIN, ONE, RIVALS = (NAMES.index(f"effect.{name}") for name in ("gain", "one", "rivals"))


def drawn_cases(n, weights, seed=4):
    """Cases of six explanations, of which one is true with the probability that weights give."""
    rng, cases = np.random.default_rng(seed), []
    for _ in range(n):
        x = np.zeros((6, len(NAMES)))
        x[:4, GAIN], x[:4, ONE] = rng.uniform(0.0, 4.0, 4), 1.0
        x[:4, RIVALS] = rng.integers(0, 2, 4)
        u = x @ weights
        p = np.exp(u) / np.exp(u).sum()
        cases.append(SimpleNamespace(
            x=x, fixed=np.zeros(6), names=list("abcdef"), label={"kind": "single"},
            right=np.arange(6) == rng.choice(6, p=p),
        ))
    return cases


def test_the_likeliest_weights_are_those_that_the_cases_were_drawn_with():
    true = np.zeros(len(NAMES))
    true[[GAIN, ONE, RIVALS]] = 1.5, -2.0, -0.8
    weights, covariance = fit_weights(drawn_cases(3000, true), 0.1, 0.0)
    errors = np.sqrt(np.diag(covariance))
    for k in (GAIN, ONE, RIVALS):
        assert abs(weights[k] - true[k]) < 4.0 * errors[k] < 0.5
    # More gain never speaks against an effect, whatever some cases say.
    true[GAIN] = -1.0
    assert fit_weights(drawn_cases(300, true), 0.1, 0.0)[0][GAIN] == 0.0


def test_a_set_of_all_that_reach_the_threshold_holds_the_truth_in_nine_of_ten():
    rng = np.random.default_rng(1)
    shares = rng.dirichlet(np.full(8, 0.3), 4000)
    truth = np.array([rng.choice(8, p=p) for p in shares])
    least = conformal(shares[np.arange(2000), truth[:2000]])
    held = [t in credible(p, least) for p, t in zip(shares[2000:], truth[2000:], strict=True)]
    assert 0.87 < np.mean(held) < 0.93
    assert credible(np.array([0.01, 0.02, 0.01]), 0.5) == [1]


def test_what_is_right_to_say():
    def label(kind, loops=False, **severities):
        return {"kind": kind, "effects": list(severities), "severities": severities,
                "severity": max(severities.values(), default=0.0),
                "inner_loops": loops, "beyond_parameters": None}

    names = ["slack", "latent_heat", "latent_heat+slack"]
    assert right_names(label("none"), names, {}) == {"recalibration", "no_gap"}
    loops = "partial_transformation"
    assert right_names(label("none", loops=True), names, {}) == {"recalibration", "no_gap", loops}
    beside = right_names(label("single", loops=True, slack=9.0), names, {})
    assert beside == {"slack", f"{loops}+slack"}
    assert right_names(label("outside", friction=9.0), names, {}) == {"unexplained"}
    assert right_names(label("single", slack=9.0), names, {}) == {"slack"}
    assert right_names(label("single", slack=0.5), names, {}) >= {"slack", "no_gap"}
    as_parameters = {**label("single", slack=9.0), "beyond_parameters": 2.0}
    assert right_names(as_parameters, names, {}) >= {"slack", "recalibration"}
    assert right_names(label("pair", slack=9.0, latent_heat=5.0), names, {}) == {names[2]}
    assert right_names(label("pair", slack=90.0, latent_heat=5.0), names, {}) == {"slack", names[2]}


@pytest.fixture(scope="module")
def lines():
    """Stored features of the development cases, and the log probability that chance gives them."""
    assert gzip.decompress(STORED.read_bytes()).startswith(b'{"library"')
    found = learn.stored([STORED])
    return found, np.mean([np.log(learn.Known(line).right.mean()) for line in found])


def test_the_table_of_weights_is_what_the_stored_features_give_and_says_more_than_chance(lines):
    cases, table = [learn.Known(line) for line in lines[0]], learnt()
    weights = fit_weights(cases, table.ridge, table.fit_lapse)[0]
    assert weights == pytest.approx(table.values, abs=0.01)
    shares = [np.exp(c.x @ weights + c.fixed) for c in cases]
    answers = learn.lapsed([p / p.sum() for p in shares], table.lapse)
    assert np.mean(learn.log_probability(cases, answers)) > lines[1] + 1.0
