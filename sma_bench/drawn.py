"""What draws itself: `plot()` of records, simulations, overlays, identifications and diagnoses. The
drawing room lies above all of them and brings matplotlib: the package itself, above both, gives it
in, nothing here depends on it, and the first plot imports it."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar


class Drawn:
    """What `plot` can draw; `drawing_room` imports a module of the room that draws."""

    drawing_room: ClassVar[Callable[[str], ModuleType]]

    def plot(self, *what: str) -> Any:
        """A picture that a notebook shows, with the matplotlib `figure` and `save(path)` as PNG,
        SVG, PDF or CSV. `what`, else what matters most: of a record, a simulation or an overlay
        signals or quantities ("wire.current", "temperature"), of an identification "agreement", of
        a diagnosis "signals", "where" or "evidence". Raises InputError: nothing has that name."""
        return Drawn.drawing_room("plots").picture_of(self, *what)


class Reported(Drawn):
    """What has a page of its own too; `writer`: the module of the drawing room and its function."""

    writer: ClassVar[tuple[str, str]]

    def report(self, folder: str | Path, *more: Any) -> Path:
        """Write the page with its figures into a folder; the path of its index.html. Raises
        InputError: the folder cannot be written, or holds what is not a report's. `more`: as the
        function of the drawing room has it."""
        module, function = self.writer
        page: Path = getattr(Drawn.drawing_room(module), function)(folder, self, *more)
        return page
