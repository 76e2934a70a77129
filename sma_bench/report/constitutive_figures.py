"""E9 and E10: what was measured, and the model that was fitted to all of it."""

import numpy as np

from sma_bench.identify.estimate import Experiment
from sma_bench.report.drawing import MEASURED, MODEL, new_figure
from sma_bench.report.page import Picture

_ROWS = 4
_FIRST = ("deflection", "force", "elongation", "temperature", "current")
_UNITS = {"deflection": "m", "force": "N", "elongation": "m", "temperature": "K", "current": "A"}


def constitutive_picture(e9: Experiment) -> Picture:
    """Strain over temperature of every loop with the fitted law."""
    figure, (ax,) = new_figure(height=4.6)
    loops = [key.removesuffix("/model") for key in e9.curves if key.endswith("/model")]
    for k, loop in enumerate(loops):
        temperature = e9.curves[f"{loop}/temperature"]
        ax.plot(
            temperature, 100.0 * e9.curves[f"{loop}/strain"], ".", ms=2, color=f"C{k % 10}",
            label=loop, rasterized=True,
        )
        ax.plot(temperature, 100.0 * e9.curves[f"{loop}/model"], color="black", lw=0.8)
    ax.set(xlabel="temperature [K]", ylabel="strain [%]")
    ax.legend(fontsize=7, markerscale=4, ncols=2 if len(loops) > 6 else 1)
    caption = (
        f"Strain under held stress, measured (points) and eqs. (6), (7), (9) to (11) fitted to all "
        f"loops at once (lines). {e9.source}"
    )
    return Picture("constitutive_fit", "Joint fit of the constitutive law", caption, figure)


def bench_fit_pictures(e10: Experiment) -> list[Picture]:
    """Signals of the rig over time with the fitted simulation, one picture a record."""
    signals = [key.removesuffix(".model") for key in e10.curves if key.endswith(".model")]
    records: dict[str, list[str]] = {}
    for signal in signals:
        head, _, rest = signal.partition(".")
        records.setdefault(head if head.isdecimal() and rest else "", []).append(signal)
    return [_bench_fit_picture(e10, head, chosen) for head, chosen in records.items()]


def _bench_fit_picture(e10: Experiment, head: str, signals: list[str]) -> Picture:
    shown = sorted(signals, key=lambda s: _FIRST.index(_quantity(s)))[:_ROWS]
    figure, axes = new_figure(rows=len(shown), height=1.2 + 1.9 * len(shown))
    for ax, signal in zip(axes, shown, strict=True):
        time, measured, model = (
            e10.curves[f"{signal}.{part}"] for part in ("time", "measured", "model")
        )
        rms = float(np.sqrt(np.nanmean((measured - model) ** 2)))
        unit = _UNITS[_quantity(signal)]
        ax.plot(time, measured, ".", ms=1.5, color=MEASURED, label="measured", rasterized=True)
        ax.plot(time, model, color=MODEL, lw=1, label=f"model, rms {rms:.2g} {unit}")
        ax.set(ylabel=f"{signal.removeprefix(f'{head}.')}\n[{unit}]")
        ax.legend(fontsize=8)
    axes[-1].set(xlabel="time [s]")
    number = f"_{head}" if head else ""
    caption = (
        "The baseline model, eqs. (2), (6), (7), (9) to (11), (22), (23), simulated on the "
        f"measured voltages with the fitted parameters. {e10.source}"
    )
    return Picture(f"bench_fit{number}", "Measured and fitted signals", caption, figure)


def _quantity(signal: str) -> str:
    name = signal.rpartition(".")[2]
    return name if name in _FIRST else _FIRST[-1]
