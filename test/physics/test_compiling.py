"""What is said while functions are compiled, once after an installation."""

import pytest

from sma_bench import compiled

numba = pytest.importorskip("numba")


def test_whether_there_is_machine_code_yet(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "_cache_folder", lambda room: tmp_path / room.name)
    assert not compiled.is_compiled("physics")
    (tmp_path / "physics").mkdir()
    assert not compiled.is_compiled("physics")
    (tmp_path / "physics" / "kernel.nbi").touch()
    assert compiled.is_compiled("physics")


def test_nothing_has_to_be_waited_for_without_numba(monkeypatch):
    monkeypatch.setattr(compiled, "numba", None)
    assert compiled.is_compiled("physics")
    compiled.when_compiling(lambda: pytest.fail("nothing is ever compiled"))


def test_a_function_that_is_compiled_is_told_of_once():
    told = []
    listener = compiled.when_compiling(lambda: told.append("compiling"))
    twice = numba.njit(lambda x: 2.0 * x)
    try:
        assert (twice(1.5), twice(2.0)) == (3.0, 4.0)
    finally:
        numba.core.event.unregister("numba:compile", listener)
    assert told == ["compiling"]
