"""One slip of the paper: printed and corrected form, with numbers."""

from dataclasses import dataclass

from sma_bench.report.page import Section, Table

_HEADER = ("", "as printed", "corrected", "independent check")

Line = tuple[str, str, str, str]


@dataclass(frozen=True)
class Erratum:
    """One item.

    Attributes:
        number: 1 to 11; place: in the paper.
        printed, corrected: the forms, in words or as a formula.
        lines: (quantity, printed, corrected, check) with units, ready to read.
        remark: what follows.
    """

    number: int
    place: str
    printed: str
    corrected: str
    lines: tuple[Line, ...] = ()
    remark: str = ""

    def section(self) -> Section:
        """For a report."""
        table = Table(_HEADER, [("form", self.printed, self.corrected, ""), *self.lines])
        return Section(
            f"Erratum {self.number}: {self.place}", tables=[table],
            notes=[self.remark] if self.remark else [],
        )


def line(
    quantity: str, unit: str, printed: float, corrected: float, check: float | None = None,
    how: str = "",
) -> Line:
    """Numbers of one quantity; `check` comes from elsewhere, `how` says from where."""
    shown = "" if check is None else f"{check:.5g} {unit}, {how}"
    return quantity, f"{printed:.5g} {unit}", f"{corrected:.5g} {unit}", shown
