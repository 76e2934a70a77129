"""The measures by name: those with a floor and an aim, and those that are reported besides."""

from sma_bench.blind.measures import (
    Measure,
    anyone,
    clean,
    detectable,
    distinguishable,
    first_choice_calibration,
    kinetics,
    not_pair,
    outside,
    pair,
    parameter_error,
    place,
    seconds,
    set_size,
    share_of,
    shrinkage_bias,
    shrinkage_coverage,
    shrinkage_error,
    single,
    true_shrinkage,
)
from sma_bench.blind.statistics import mean

# The table of floors and aims, row by row.
TARGETS = (
    Measure(
        "detection of gaps above twice the noise",
        "cases with something wrong and a measured gap above 2 noise standard deviations; any "
        "verdict but no_gap, an ambiguous one only without no_gap in its 90 % set",
        share_of(lambda c: c.says_gap, detectable), floor=0.97, aim=0.99,
        given="false alarms on no effect",
    ),
    Measure(
        "false alarms on no effect",
        "cases with nothing wrong, noise white, coloured or drifting; verdict effect or "
        "unexplained, or ambiguous with neither no_gap nor recalibration in its 90 % set",
        share_of(lambda c: c.alarms, clean), "lower", floor=0.02, aim=0.005,
    ),
    Measure(
        "false alarms on benign kinetics mismatch",
        "the same over cases with mildly different kinetics and nothing else",
        share_of(lambda c: c.alarms, kinetics), "lower", floor=0.10, aim=0.05,
    ),
    Measure(
        "first choice right, distinguishable singles",
        "single effects that stand 5 standard deviations off every rival; the most probable "
        "candidate is the effect",
        share_of(lambda c: c.first_choice_right, distinguishable), floor=0.90, aim=0.95,
    ),
    Measure(
        "90 % set holds the truth",
        "all cases but pairs; the fewest candidates that make 90 % have the truth among them",
        share_of(lambda c: c.set_holds_truth, not_pair), floor=0.88, aim=0.90,
    ),
    Measure(
        "90 % set, mean size", "all answers; number of candidates in the 90 % set",
        set_size, "lower", "number", floor=2.0, aim=1.4, given="90 % set holds the truth",
    ),
    Measure(
        "probability given to the truth",
        "all cases; summed over candidates that are made of nothing but what is true",
        lambda cases: mean([c.truth_probability for c in cases]), style="number",
        floor=0.80, aim=0.88,
    ),
    Measure(
        "out-of-library: abstains or flags",
        "effects that no library has, gap above 2; verdict ambiguous or unexplained, or "
        "unexplained in the 90 % set",
        share_of(lambda c: c.abstains_or_flags, outside), floor=0.80, aim=0.90,
    ),
    Measure(
        "confident and wrong",
        "all cases; verdict effect with a cause that shares nothing with the truth, or a candidate "
        "that shares nothing with it at 0.8 or more",
        share_of(lambda c: c.confident_and_wrong, anyone), "lower", floor=0.05, aim=0.02,
    ),
    Measure(
        "claimed against true shrinkage, median",
        "cases that claim to shrink a gap which is there; |claimed - true fraction| on a protocol "
        "that nobody saw",
        shrinkage_error(0.5), "lower", "points", floor=0.05, aim=0.02,
    ),
    Measure(
        "claimed against true shrinkage, 90th percentile", "the same",
        shrinkage_error(0.9), "lower", "points", floor=0.15, aim=0.08,
    ),
    Measure(
        "90 % interval of shrinkage covers", "the same cases; the true fraction is inside",
        shrinkage_coverage, "inside", floor=(0.84, 0.95), aim=(0.87, 0.93),
    ),
    Measure(
        "pairs: at least one", "pairs of effects; the cause (without one, the most probable "
        "candidate) names one of them or both",
        share_of(lambda c: bool(c.named & c.label.names), pair), floor=0.95, aim=0.98,
    ),
    Measure(
        "pairs: both", "the same; it names both",
        share_of(lambda c: c.label.names <= c.named, pair), floor=0.65, aim=0.80,
    ),
    Measure(
        "where: signal", "effects with a gap above 2; the quantity with the largest gap",
        place("signal"), floor=0.95, aim=0.98,
    ),
    Measure(
        "where: phase", "the same; drive, rest or initial",
        place("phase"), floor=0.90, aim=0.95,
    ),
    Measure(
        "where: stage", "the same; electrical, thermal, transformation, mechanical or sensor",
        place("stage"), floor=0.85, aim=0.93,
    ),
    Measure(
        "the suggested experiment resolves the tie",
        "ambiguous answers with a protocol, performed on the case's own world; the second answer "
        "is not ambiguous and its most probable candidate is right",
        share_of(lambda c: c.resolved, lambda c: c.followed), floor=0.65, aim=0.85,
    ),
)


def _noise_alarm(noise: str) -> Measure:
    return Measure(
        f"false alarms, {noise} noise", "cases with nothing wrong and this noise",
        share_of(lambda c: c.alarms, lambda c: clean(c) and c.label.noise == noise), "lower",
    )


# Reported without a floor.
OTHERS = (
    Measure(
        "answered", "all cases; an answer to the contract in time",
        share_of(lambda c: c.answer is not None, anyone),
    ),
    *(_noise_alarm(noise) for noise in ("white", "coloured", "drift")),
    Measure(
        "wrong parameters taken for an effect", "recalibration cases; alarms as above",
        share_of(lambda c: c.alarms, lambda c: c.label.kind == "recalibration"), "lower",
    ),
    Measure(
        "recalibration recognised", "recalibration cases; most probable candidate",
        share_of(lambda c: c.first_choice_right, lambda c: c.label.kind == "recalibration"),
    ),
    Measure(
        "effects seen as effects", "single, pair, outside with a gap above 2; alarms as above",
        share_of(
            lambda c: c.answer is not None and c.alarms,
            lambda c: detectable(c) and c.label.kind != "recalibration",
        ),
    ),
    Measure(
        "first choice right, all singles", "",
        share_of(lambda c: c.first_choice_right, single),
    ),
    Measure(
        "first choice in the right stage, all singles", "",
        share_of(lambda c: c.family_right, single),
    ),
    Measure(
        "probability given to the truth, distinguishable singles", "",
        lambda cases: mean([c.truth_probability for c in cases if distinguishable(c)]),
        style="number",
    ),
    Measure(
        "abstention", "all cases; verdict ambiguous or unexplained",
        share_of(lambda c: c.abstains, anyone), "lower",
    ),
    Measure(
        "calibration error", "most probable candidates; expected calibration error over ten bins",
        first_choice_calibration, "lower", "points",
    ),
    Measure("where: side", "effects with a gap above 2", place("side")),
    Measure("true shrinkage, median", "cases that claim one", true_shrinkage, style="points"),
    Measure(
        "claimed minus true shrinkage, median", "the same", shrinkage_bias, "inside", "points"
    ),
    Measure(
        "parameter error before, median", "root mean square over the stated parameters of "
        "(lab's - true)/stated standard deviation",
        parameter_error(0), "lower", "number",
    ),
    Measure(
        "parameter error after, median", "the same of the improved file",
        parameter_error(1), "lower", "number",
    ),
    Measure("time to answer, median", "", seconds(0.5), "lower", "seconds"),
    Measure("time to answer, 90th percentile", "", seconds(0.9), "lower", "seconds"),
)
