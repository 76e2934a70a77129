"""Opens a record whatever it is: a bag or an instrument's file."""

from pathlib import Path

from sma_bench.errors import InputError
from sma_bench.records.bag import read_record
from sma_bench.records.bag_files import is_bag
from sma_bench.records.dsc import DscRecord, is_dsc, read_dsc
from sma_bench.records.record import Record


def open_record(path: str | Path, namespace: str | None = None) -> Record | DscRecord:
    """Read a bag or an instrument file; which one is decided by its content.

    Raises:
        InputError: neither, or nothing readable in it.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if is_bag(path):
        return read_record(path, namespace)
    if is_dsc(path):
        return read_dsc(path)
    raise InputError(
        f"{path}: neither a bag (folder, .mcap, .db3) nor an instrument file known here "
        "(PerkinElmer Pyris DSC text export)"
    )
