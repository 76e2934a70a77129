"""Figs. 1 and 11 to 14 of the paper, set-ups and diagrams of its own rigs, as they ship."""

from importlib import resources

from sma_bench.report.page import Drawing

# Name, title, caption by the paper's number.
_DRAWINGS = {
    1: (
        "figure_01_wire_rig", "Set-up for the identification",
        "Drawing, not to scale: a wire between clamps, heated by its own current, its voltage, "
        "current and temperature measured.",
    ),
    11: (
        "figure_11_bench", "Test bench of the composite",
        "Drawing, not to scale, of what section IV and Fig. 11 describe: the composite hangs from "
        "a clamp, two wires on either side; two triangulation sensors see the deflection of eq. "
        "(17) at the distance l from the clamp. Drawn from the text of the paper, whose own "
        "picture was not at hand.",
    ),
    12: (
        "figure_12_specimen", "Specimen of the composite",
        "To scale: matrix with wires of 0.3 mm at the distance a from its middle.",
    ),
    13: (
        "figure_13_moment", "Force, moment and deflection",
        "To scale: the front wires just austenite. Their force at the distance a from the middle "
        "bends the composite to a constant curvature, dφ/dx of eq. (14).",
    ),
    14: (
        "figure_14_block_diagram", "Block diagram of the composite",
        "Each wire by itself to its stress; those of a side bend together, the deflection is that "
        "of the front less that of the back.",
    ),
}


def setup_drawings() -> dict[int, Drawing]:
    """By the paper's number."""
    folder = resources.files("sma_bench.report").joinpath("drawings")
    return {
        number: Drawing(
            name, f"Fig. {number}: {title}", f"{caption} Data: none, the numbers are the paper's.",
            folder.joinpath(f"{name}.svg").read_bytes(),
        )
        for number, (name, title, caption) in _DRAWINGS.items()
    }
