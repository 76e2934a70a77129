"""The soak of sound benches: minutes of each part, what is counted, and benches that are not."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from examination.check import soak
from sma_bench.hardware.safety import CELSIUS_ZERO

WORLD = soak.draw_world(np.random.default_rng(0))
SOUND = replace(WORLD, room=CELSIUS_ZERO + 5.0, draught=0.0, age=(1.2,) * 4, austenite=0.0,
                noise=4.0, slow=False, sag=0.1, dip=0.08, camera=True,
                errors=(0.01, 0.02, -0.02, 0.05, -2.0))  # fmt: skip


@pytest.mark.parametrize(("kind", "seconds", "unsound", "said"), [
    ("a wire", 240.0, {"age": (2.0,) * 4}, "disagreement: wire carries"),
    ("four wires", 60.0, {"errors": (0.0, 0.8, 0.0, 0.0, 0.0)}, "over-current: front_1"),
    ("firmware", 240.0, {"errors": (0.0, 0.0, 0.0, 0.4, 0.0)}, "device: "),
])  # fmt: skip
def test_a_bench_is_switched_off_with_a_fault_and_not_without(kind, seconds, unsound, said):
    if kind == "firmware" and shutil.which("cc") is None:
        pytest.skip("no C compiler (cc) here")
    assert soak.PLAYS[kind](SOUND, 1, seconds) == []
    cuts = soak.PLAYS[kind](replace(SOUND, **unsound), 1, seconds)
    assert cuts and all(0.0 <= at <= seconds for at, _ in cuts)
    assert any(reason.startswith(said) for _, reason in cuts), cuts
