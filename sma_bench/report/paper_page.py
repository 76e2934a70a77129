"""The paper redrawn: its figures, tables and errata as one page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from sma_bench.findings import Finding
from sma_bench.identify.estimate import Experiment
from sma_bench.report.bench_drawing import bench_picture
from sma_bench.report.composite_figures import (
    CompositeRun,
    composite_deflection_picture,
    composite_voltage_picture,
)
from sma_bench.report.drawing import FAINT
from sma_bench.report.dsc_overview import dsc_overview_picture
from sma_bench.report.errata_figures import errata_picture
from sma_bench.report.erratum import Erratum
from sma_bench.report.isobaric_figures import stress_temperature_picture, upfr_picture
from sma_bench.report.page import Picture, Section, Table
from sma_bench.report.paper_errata import errata_sections
from sma_bench.report.paper_results import Outcome
from sma_bench.report.paper_tables import TABLES, Row, html_table
from sma_bench.report.tensile_figures import tensile_picture, thermal_expansion_picture
from sma_bench.report.thermal_figures import (
    heat_transfer_picture,
    ramp_picture,
    resistance_picture,
    slope_picture,
)

# Figure of the paper: (kind of experiment, equations that it shows, how it is drawn).
EXPERIMENT_FIGURES = (
    (2, "E1", "eq. (3)", resistance_picture),
    (3, "E2", "eq. (4)", heat_transfer_picture),
    (4, "E3", "eq. (2)", ramp_picture),
    (5, "E3", "eq. (5)", slope_picture),
    (7, "E5", "eqs. (1), (10), (11)", dsc_overview_picture),
    (8, "E6", "eqs. (6), (9), (10), (11)", upfr_picture),
    (9, "E7", "eq. (7)", tensile_picture),
    (10, "E8", "eq. (8)", thermal_expansion_picture),
)
_SECTIONS = (
    # (title, figures, table)
    ("Resistance, section II.B.1", (2,), None),
    ("Heat transfer coefficient, section II.B.2", (3,), None),
    ("Specific heat, section II.B.3", (4, 5), None),
    ("Thermal parameters", (), "table_1"),
    ("Heat transfer simulation, section II.C", (6,), None),
    ("Transition temperatures by DSC, section III.B.1", (7,), "table_2"),
    ("Transition temperatures by UPFR, section III.B.1", (8,), None),
    ("Young's modulus, section III.B.2", (9,), "table_3"),
    ("Thermal expansion factor, section III.B.3", (10,), None),
    ("Numbers outside the tables", (), "numbers_in_the_text"),
    ("Test bench of the composite, section IV", (11,), None),
    ("Simulation and experiment of the composite, section IV.C", (15, 16), None),
)
# Synthetic data: what of it is the package's model and what is made up beside it.
ORIGINS = {
    2: "protocol staircase on the simulated wire rig: physics behind the simulator's sensors",
    3: "the same staircase as Fig. 2",
    4: "protocol ramp on the simulated wire rig",
    5: "the same ramps as Fig. 4",
    6: "protocol triangle on the simulated wire rig; no parameter was fitted to it",
    7: "heat flow of eq. (1) with Table II of both cycles, latent heat 20 kJ/kg (assumed), "
       "baseline drift and noise; no thermal lag",
    8: "1 N held on the simulated wire, three specimens that deviate as the paper's did; the "
       "paper could not measure the cooling",
    9: "austenite by eqs. (6), (7), (9), (11); martensite a test curve (toe, detwinning plateau "
       "to 4 %, elastic rise), which the paper's law does not describe; three specimens each that "
       "deviate as Table III says",
    10: "temperature staircase held by the PI controller on the simulated wire, clamped at 0.2 % "
        "of strain; Θ_T = -0.15 MPa/K is assumed, as the printed 23.91 is not believable",
    15: "protocols composite_triangle and composite_step on the simulated composite rig",
    16: "the same runs as Fig. 15, seen by the simulator's range sensors; the bench obeys the "
        "model, so that measured and simulated agree and the specimen's residual deflection is "
        "absent; geometry assumed, the back three times as stiff as the front (the paper says "
        "that they differ)",
}


@dataclass(frozen=True)
class PaperPage:
    """Everything the page shows.

    Attributes:
        outcomes: by kind of experiment.
        validation: Fig. 6; validation_synthetic: whether its record is.
        composite: runs of Figs. 15 and 16; composite_synthetic: whether they are.
        tables: rows by name of TABLES.
        errata, notes: at the end and at the beginning.
    """

    outcomes: Mapping[str, Outcome]
    validation: Picture
    validation_synthetic: bool
    composite: Sequence[CompositeRun]
    composite_synthetic: bool
    tables: Mapping[str, Sequence[Row]]
    errata: Sequence[Erratum]
    notes: Sequence[Finding] = ()

    def pictures(self) -> dict[int, list[Picture]]:
        """Pictures by figure number of the paper, captions with equation and data source."""
        found: dict[int, list[Picture]] = {}
        for number, kind, _, draw in EXPERIMENT_FIGURES:
            outcome = self.outcomes[kind]
            drawn = [draw(experiment) for experiment in outcome.experiments]
            found[number] = [
                captioned(number, picture, outcome.synthetic, k)
                for k, picture in enumerate(drawn)
            ]
        found[6] = [captioned(6, self.validation, self.validation_synthetic)]
        bench = bench_picture()
        found[11] = [replace(bench, title=f"Fig. 11: {bench.title}")]
        for number, draw_runs in (
            (15, composite_voltage_picture), (16, composite_deflection_picture),
        ):
            found[number] = [
                captioned(number, draw_runs(self.composite), self.composite_synthetic)
            ]
        return dict(sorted(found.items()))

    def sections(self) -> list[Section]:
        """In the paper's order."""
        pictures = self.pictures()
        sections = [self._contents(pictures)]
        for title, numbers, table in _SECTIONS:
            tables = [html_table(table, self.tables[table])] if table else []
            shown = [picture for number in numbers for picture in pictures[number]]
            heading = f"{TABLES[table][0]}" if table and not numbers else title
            sections.append(Section(heading, tables=tables, pictures=shown,
                                    notes=self._remarks(numbers)))
        sections.append(self._beyond())
        errata = errata_sections(self.errata)
        errata[0] = replace(errata[0], pictures=[errata_picture()])
        return sections + errata

    def _contents(self, pictures: Mapping[int, Sequence[Picture]]) -> Section:
        rows = []
        equations = {number: text for number, _, text, _ in EXPERIMENT_FIGURES}
        equations |= {6: "eq. (2)", 11: "", 15: "eq. (2)", 16: "eqs. (15), (17)"}
        for number, drawn in pictures.items():
            data = "drawing" if number == 11 else self._data(number)
            rows.append((f"Fig. {number}", drawn[0].title.partition(": ")[2], equations[number],
                         data))
        return Section(
            "Contents", tables=[Table(("", "shows", "of", "data"), rows)],
            paragraphs=["Figures 1 and 12 to 14 of the paper show set-ups and diagrams, no data. "
                        "Tables are written as CSV, figures as PNG beside this page."],
            notes=[str(note) for note in self.notes],
        )

    def _data(self, number: int) -> str:
        kinds = {n: kind for n, kind, _, _ in EXPERIMENT_FIGURES}
        if number == 6:
            synthetic = self.validation_synthetic
        elif number in kinds:
            synthetic = self.outcomes[kinds[number]].synthetic
        else:
            synthetic = self.composite_synthetic
        return "synthetic" if synthetic else "record given"

    def _remarks(self, numbers: Sequence[int]) -> list[str]:
        """Warnings of the experiments behind these figures."""
        kinds = dict.fromkeys(kind for n, kind, _, _ in EXPERIMENT_FIGURES if n in numbers)
        found = [
            f"{finding.subject}: {finding.text}"
            for kind in kinds
            for experiment in self.outcomes[kind].experiments
            for finding in experiment.findings
            if finding.severity != "info" or finding.subject == "prestrain"
        ]
        return list(dict.fromkeys(found))

    def _beyond(self) -> Section:
        """C_A and C_M, which the paper uses and does not give."""
        outcome = self.outcomes["E6 stresses"]
        pictures = [
            _captioned(
                stress_temperature_picture(experiment), outcome.synthetic,
                "isobaric tests of the simulated wire at five stresses; C_A = C_M = 7 MPa/K is "
                "assumed",
            )
            for experiment in outcome.experiments
            if _has_diagram(experiment)
        ]
        return Section("Influence of stress, section III.B.4 (no figure in the paper)",
                       pictures=pictures)


def captioned(number: int, picture: Picture, synthetic: bool, index: int = 0) -> Picture:
    """The picture as a figure of the paper: number and data source added, equation in it."""
    titled = replace(
        picture, title=f"Fig. {number}: {picture.title}",
        name=picture.name if not index else f"{picture.name}_{index + 1}",
    )
    return _captioned(titled, synthetic, ORIGINS[number])


def _captioned(picture: Picture, synthetic: bool, origin: str) -> Picture:
    # The PNG may go its own way: it says by itself what it is not.
    text = "synthetic data" if synthetic else "data: record given"
    picture.figure.axes[0].set_title(text, loc="right", fontsize=8, color=FAINT, style="italic")
    data = f"Data: synthetic ({origin})." if synthetic else "Data: record given."
    return replace(picture, caption=f"{picture.caption.rstrip('. ')}. {data}")


def _has_diagram(experiment: Experiment) -> bool:
    return any(
        key.startswith("diagram/") and key.endswith("/stress") and len(values) > 1
        for key, values in experiment.curves.items()
    )
