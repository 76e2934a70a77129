"""`plot()` and `report()` as methods of records, simulations, overlays and results. They call the
package `report`, which imports these types and matplotlib; so `sma_bench/__init__.py` passes it in
as `import_report`, and it is imported at the first plot."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar


class Drawn:
    """Something with a `plot` method; `import_report` imports a module of the package `report`."""

    import_report: ClassVar[Callable[[str], ModuleType]]

    def plot(self, *what: str) -> Any:
        """A picture that a notebook shows, with the matplotlib `figure` and `save(path)` as PNG,
        SVG, PDF or CSV. `what`, optional: for a record, a simulation or an overlay, signals or
        quantities ("wire.current", "temperature"); for an identification "agreement"; for a
        diagnosis "signals", "where" or "evidence". Raises InputError: there is no such part."""
        return Drawn.import_report("plots").picture_of(self, *what)


class Reported(Drawn):
    """Something that also has a page; `writer`: module and function of `report` that write it."""

    writer: ClassVar[tuple[str, str]]

    def report(self, folder: str | Path, *more: Any) -> Path:
        """Write the page with its figures into a folder; the path of its index.html. `more`: other
        arguments of the function in `report`. Raises InputError: the folder cannot be written, or
        contains a foreign file of the same name."""
        module, function = self.writer
        page: Path = getattr(Drawn.import_report(module), function)(folder, self, *more)
        return page
