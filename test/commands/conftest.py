"""What the tests of commands share."""

import pytest

from sma_bench.commands import progress_bar


@pytest.fixture(autouse=True)
def _no_progress_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a loaded machine any command may be slow enough to say so; errors are counted by line."""
    monkeypatch.setattr(progress_bar, "FIRST_LINE", 1e6)
