"""Fixtures for all tests: shared data, a diagnosis, an Uno, a ROS domain of its own."""

import contextlib
import fcntl
import gc
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import pytest
import yaml

from sma_bench.ros.processes import USERS_VARIABLES, choose_discovery

ROOT = Path(__file__).resolve().parents[1]

# Must be set before rclpy is imported: field checks turn a silent 5e-324 into an exception.
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
for variable in USERS_VARIABLES:
    os.environ.pop(variable, None)
choose_discovery()
os.environ.setdefault("ROS_LOG_DIR", os.path.join(tempfile.gettempdir(), "sma_bench_test_log"))
os.environ.setdefault("MPLBACKEND", "Agg")
# pytest-xdist sets it; tables would be folded to this width.
os.environ.pop("COLUMNS", None)
# Must be set before numpy is imported, as the command line does: one BLAS thread.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# As ./bench does: without byte code, each process would compile the package.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Tests end processes by SIGHUP and SIGINT; under nohup or a shell's `&` these would be ignored.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine must not make tests fail; a hang is still detected.
hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.load_profile("any machine")

ORDER = yaml.safe_load((ROOT / "test" / "order.yaml").read_text())
LONGEST, RERUN = ORDER["longest"], ORDER["rerun"]

# Above 101 the ports of a domain overlap Linux's ephemeral ports.
DOMAINS = range(10, 102)
LOCKS = Path(tempfile.gettempdir()) / f"sma_bench_ros_domains_{os.getuid()}"


def pytest_addoption(parser):
    what = "the minutes in real time on the emulated Uno too"
    parser.addoption("--acceptance", action="store_true", help=what)


def pytest_collection_modifyitems(config, items):
    for item in items:
        if item.get_closest_marker("acceptance") and not config.getoption("--acceptance"):
            item.add_marker(pytest.mark.skip(reason="minutes in real time: only with --acceptance"))
        if item.nodeid.partition("[")[0] in RERUN:
            item.add_marker(pytest.mark.flaky(reruns=2))
    # First the listed tests in their order, so that no worker is left with them; then long ones.
    long = {item.path for item in items if item.get_closest_marker("slow")}
    order = {ROOT / "test" / f"{name}.py": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path, len(LONGEST) + (item.path not in long)))


def pytest_runtest_setup(item):
    if item.get_closest_marker("compiled") and find_spec("numba") is None:
        pytest.skip("fits of whole records take minutes uncompiled")


def pytest_collection_finish():
    """Exclude modules and tests from garbage collection, which took a sixth of the time."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Workers for `-n auto`: two more than processors, as tests of nodes mostly wait."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.fixture(scope="session", autouse=True)
def _one_core_a_worker():
    """With several workers, one thread per fit: a second one would only wait for a core."""
    with pytest.MonkeyPatch.context() as patch:
        if "PYTEST_XDIST_WORKER" in os.environ:
            from sma_bench import compiled

            patch.setattr(compiled, "_THREADS", 0)
        yield


@pytest.fixture
def both_cores(monkeypatch):
    """Fits with two threads, also in a worker."""
    from sma_bench import compiled

    monkeypatch.setattr(compiled, "_THREADS", 2)


@pytest.fixture
def as_any_process(monkeypatch):
    """Nodes in the test's own process do not change its scheduling."""
    monkeypatch.setattr(os, "sched_setscheduler", lambda *given: None)


@pytest.fixture(autouse=True)
def _scheduled_as_before():
    yield
    assert os.sched_getscheduler(0) == os.SCHED_OTHER, "ask for as_any_process"


@pytest.fixture(scope="session")
def measured_data():
    """Folder of reduced measurements of other laboratories (sources in its README.md)."""
    return ROOT / "test" / "data"


@pytest.fixture(scope="session")
def shared_data():
    """Folder of records beside the checkout."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no records beside the checkout ({folder})")
    return folder


@pytest.fixture(scope="session")
def planted_diagnosis(tmp_path_factory):
    """Diagnosis of a bench whose sides heat each other: all signals, one hold-out record. The
    first worker that needs it makes it, the others read its file."""
    import joblib
    from planted import believed, few_effects, planted_pair

    from sma_bench import compiled
    from sma_bench.diagnose import diagnose

    if compiled.numba is None:
        pytest.skip("without numba a diagnosis takes minutes")

    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    with (folder / "planted.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (made := folder / "planted_diagnosis").exists():
            effect = {"effect.side_heat_coupling.conductance": 0.002}
            seen, unseen = planted_pair(tmp_path_factory.mktemp("planted"), effect)
            with few_effects():
                joblib.dump(diagnose(seen, believed(), unseen), made)
        return joblib.load(made)


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are made but not rendered: PNG, SVG and PDF take a second each."""
    from sma_bench.report.page import Picture

    monkeypatch.setattr(Picture, "_file", lambda *_, **__: b"\x89PNG")


@pytest.fixture(scope="session")
def papers_experiments_once():
    """Every `paper` page uses the same synthetic experiments of the paper's wire."""
    from sma_bench.paper import lab
    from sma_bench.parameters import Parameters

    run, made = lab._synthetic_outcomes, {}

    def once(paper, measured, report):
        if dict(paper) != dict(Parameters.defaults()):
            return run(paper, measured, report)
        made.update(made or run(paper, {}, report))
        return {kind: outcome for kind, outcome in made.items() if kind not in measured}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lab, "_synthetic_outcomes", once)
        yield


@pytest.fixture(scope="session")
def firmware_image(tmp_path_factory):
    """The firmware image of the Uno."""
    from uno.emulated_uno import build_firmware

    if shutil.which("avr-gcc") is None:
        pytest.skip("no avr-gcc here (Debian packages gcc-avr, binutils-avr, avr-libc)")
    return build_firmware(tmp_path_factory.mktemp("firmware"))


@pytest.fixture(scope="session")
def emulator(tmp_path_factory):
    """The emulated Uno, built."""
    from uno.emulated_uno import build_emulator, missing_tools

    if missing := missing_tools():
        pytest.skip(missing)
    return build_emulator(tmp_path_factory.mktemp("emulator"))


@pytest.fixture
def uno(emulator, firmware_image):
    """An Uno with the real image, just powered up."""
    from uno.emulated_uno import EmulatedUno

    return EmulatedUno(emulator, firmware_image)


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium; not kept for the session, because it keeps an event loop running."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no browser here (Debian package chromium)")
    # Options to run as root and without network requests of the browser itself.
    options = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
               "--disable-background-networking", "--disable-component-update",
               "--disable-sync"]  # fmt: skip
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=program, args=options, timeout=120e3)
        yield chromium
        chromium.close()


@pytest.fixture
def ros_domain(monkeypatch):
    """A ROS_DOMAIN_ID that no other test on this machine uses."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    LOCKS.mkdir(exist_ok=True)
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        with (LOCKS / str(domain)).open("w") as lock, contextlib.suppress(BlockingIOError):
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            yield domain
            return
    pytest.fail(f"no free ROS domain: all of {LOCKS} are locked")


@pytest.fixture
def nodes_forked(monkeypatch):
    """NodeProcesses forks its nodes, which saves the second of loading libraries."""
    from forked_nodes import ForkedNode

    from sma_bench.ros import processes

    def started(command, stdout, **_):
        assert command[1:3] == ["-m", "sma_bench.nodes.start"]
        return ForkedNode(command[3], command[4:], stdout.name)

    names = ("STDOUT", "DEVNULL", "TimeoutExpired")
    stand_in = SimpleNamespace(Popen=started, **{name: getattr(subprocess, name) for name in names})
    monkeypatch.setattr(processes, "subprocess", stand_in)
