"""Three naive rivals of the diagnosis, which sit the same examination."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sma_bench.blind.rivals import bic, rmse, score_test
from sma_bench.blind.rivals.observed import Observed, observe
from sma_bench.blind.rivals.statement import statement
from sma_bench.parameters import Parameters
from sma_bench.records import Record

Choose = Callable[[Sequence[Observed], Parameters], tuple[dict[str, float], Parameters]]
RIVALS: Mapping[str, Choose] = {
    "rmse": rmse.choose, "score": score_test.choose, "bic": bic.choose,
}  # fmt: skip


def rival_answer(
    name: str, records: Sequence[Record], hold_out: Sequence[Record], nominal: Parameters
) -> tuple[dict[str, Any], Parameters]:
    """What a rival says, to the contract, and its improved parameters.

    Args:
        name: of RIVALS.
        records: to fit; hold_out: to measure the shrinkage on.
        nominal: what the lab believes.

    Raises:
        InputError: a record without voltages or without anything to compare.
    """
    training = [observe(record, nominal) for record in records]
    unseen = [observe(record, nominal) for record in hold_out]
    probability, improved = RIVALS[name](training, nominal)
    return statement(probability, nominal, improved, training, unseen), improved
