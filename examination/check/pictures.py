"""Make the pictures of the documentation: screenshots of pages of synthetic records.

    ./bench check pictures

Record, results and the bench on the dashboard are those of the first tutorial; the diagnosis takes
minutes. The notebook is run and saved with its outputs (`./bench notebook` installs its packages).
"""

import contextlib
import io
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "test"), str(ROOT / "test" / "dashboard")]
from browser_page import DESKTOP, PHONE, opened  # noqa: E402
from stand_in import StandIn, served  # noqa: E402

from examination.pieces import options_of  # noqa: E402
from sma_bench.dashboard import live_state as live  # noqa: E402
from sma_bench.live.virtual_bench import VirtualBench  # noqa: E402
from sma_bench.parameters import read_parameters  # noqa: E402
from sma_bench.parameters.node_tables import SIMULATOR  # noqa: E402
from sma_bench.physics.effects import with_effect  # noqa: E402
from sma_bench.protocols import load_protocol  # noqa: E402

FOLDER, NOTEBOOK = ROOT / "docs" / "pictures", ROOT / "docs" / "tutorials" / "notebook.ipynb"
RIG = ROOT / "config" / "composite_rig.yaml"
LARGEST, COLOURS = 1_000_000, 128  # bytes of all pictures; colours of each
EFFECT = ("side_heat_coupling", 0.004)
SHOWN_AT, PERIOD = 58.0, 0.02  # s of the protocol
# Picture: page, window size, colour scheme, element (or the whole window).
PICTURES = {"dashboard.png": ("dashboard", DESKTOP, "light", ""),
            "dashboard_phone.png": ("dashboard", PHONE, "dark", ""),
            "twin.png": ("dashboard", DESKTOP, "light", "#plots"),
            "diagnosis.png": ("gap", DESKTOP, "light", "")}
# The tutorial's commands, and the files that they write.
_COMMANDS = (f"parameters --params {RIG} --set wire.resistance=2.72 --out lab.yaml",
             f"simulate --protocol composite_triangle --params {RIG} --rate 50 "
             f"--effect {EFFECT[0]}={EFFECT[1]} --noise 1 --out monday",
             "identify monday --params lab.yaml --json identified.json",
             "diagnose monday --params lab.yaml --report gap --json gap.json")


def live_bench(folder: Path) -> StandIn:
    """The synthetic bench of the tutorial in the middle of its protocol, with the twin."""
    lab, now = read_parameters(folder / "lab.yaml"), [0.0]
    hidden = with_effect(read_parameters(RIG), *EFFECT)
    protocol = load_protocol("composite_triangle", lab)
    settings = {parameter.name: parameter.default for parameter in SIMULATOR}
    quiet = {name: 0.0 if name.endswith(("_noise", "_resolution")) else value
             for name, value in settings.items()}  # fmt: skip
    bench = StandIn()
    bench.state = state = live.LiveState(lambda: now[0])
    pairs = (VirtualBench(hidden, settings), live.MEASURED), (VirtualBench(lab, quiet), live.MODEL)
    for k in range(round(SHOWN_AT / PERIOD)):
        volts = tuple(protocol.level(k * PERIOD).tolist())
        for channel, volt in zip(protocol.channels, volts, strict=True):
            state.reading("voltage", channel, volt, live.COMMANDED)
        for virtual, kind in pairs:
            for reading in virtual.advance(volts, round((k + 1) * PERIOD * 1e9)):
                now[0] = reading.time / 1e9
                for channel, value in zip(protocol.channels, reading.values, strict=False):
                    if reading.kind == "power":
                        if kind == live.MEASURED:
                            state.reading("voltage", channel, value[0], kind)
                        state.reading("current", channel, value[1], kind)
                    elif reading.kind == "temperature":
                        state.reading("temperature", channel, value + live.CELSIUS_ZERO, kind)
                if reading.kind == "mechanics":
                    standoff = settings["sensor.range_standoff"]
                    state.reading("deflection", "tip", standoff - reading.values[0], kind)
    limit = "bench.maximum_temperature"
    nodes = {"experiment": f"running: {protocol.name}", "recorder": "recording: monday",
             "identification": "idle", "diagnosis": "idle"}  # fmt: skip
    state.merge("states", nodes)
    for panel, content in {
        "channels": list(protocol.channels),
        "limits": {"values": live.shown_limits({limit: lab[limit]}),
                   "of": ["experiment", "simulator"]},
        "there": list(nodes), "stops": ["experiment"], "works": ["diagnose", "identify"],
        "recorded": "monday", "elsewhere": [],
        "progress": {"protocol": protocol.name, "step": protocol.step_at(SHOWN_AT),
                     "elapsed": SHOWN_AT, "duration": protocol.duration, "node": "experiment",
                     "heard": now[0]},
        **{node: live.result_summary(node, (folder / file).read_text()) for node, file in
           (("identification", "identified.json"), ("diagnosis", "gap.json"))}}.items():
        state.show(panel, content)
    return bench


def small(picture: bytes) -> bytes:
    image = Image.open(io.BytesIO(picture)).convert("RGB").quantize(COLOURS, dither=0)
    stream = io.BytesIO()
    image.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def main(arguments: Sequence[str]) -> int:
    options_of("pictures", __doc__, arguments)
    made = {}
    with tempfile.TemporaryDirectory() as own, sync_playwright() as driver:
        folder = Path(own)
        for command in _COMMANDS:
            words = [sys.executable, "-m", "sma_bench.cli", *command.split()]
            subprocess.run(words, cwd=folder, check=True)
        window = driver.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        with contextlib.closing(window), served(live_bench(folder)) as dashboard:
            pages = {"dashboard": dashboard, "gap": (folder / "gap" / "index.html").as_uri()}
            for name, (page, size, scheme, element) in PICTURES.items():
                with opened(window, pages[page], size, scheme) as shown:
                    shown.page.wait_for_timeout(1500)  # until figures and updates are drawn
                    target = shown.page.locator(element) if element else shown.page
                    made[name] = small(target.screenshot())
    total = sum(map(len, made.values()))
    if total > LARGEST:
        raise SystemExit(f"pictures: {total} bytes, expected at most {LARGEST}")
    FOLDER.mkdir(exist_ok=True)
    for name, content in made.items():
        (FOLDER / name).write_bytes(content)
    command = "jupyter nbconvert --to notebook --execute --inplace --log-level=ERROR"
    subprocess.run([sys.executable, "-m", *command.split(), str(NOTEBOOK)], check=True)
    print(f"{FOLDER}: {len(made)} pictures, {total} bytes, and those of the notebook")
    return 0
