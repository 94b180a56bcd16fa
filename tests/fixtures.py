"""Fixtures and options shared by all tests."""

import gc
import importlib
import itertools
import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from smarttouch.base.posix import fcntl, prioritized
from smarttouch.profile import DEFAULT_PROFILE, load_profile
from smarttouch.sources.source_contract import Frame, Pose

from .safety import attacked_profiles
from .safety.watch import Watch
from .support import full, processes

_STATES = itertools.count()

# In the background of a script, pytest ignores SIGINT, and so would programs that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Store compiled modules, whatever the environment says. Otherwise each program that tests start
# would compile the package again.
sys.dont_write_bytecode = False


def pytest_addoption(parser):
    parser.addoption(
        "--full", action="store_true", help="run long tests and all cases of each test, as CI does"
    )
    parser.addoption("--runs", type=int, help="repetitions of random tests, or their duration in s")


def pytest_configure(config):
    full.configure(config)
    # Set no deadline, because the time of a test depends on the machine's load. In CI, generated
    # inputs are always the same, so that a failure can be reproduced.
    examples, always_alike = 100 if full.WHOLE else 15, "CI" in os.environ
    settings.register_profile(
        "smarttouch", deadline=None, max_examples=examples, derandomize=always_alike
    )
    settings.load_profile("smarttouch")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Disable garbage collection while pytest collects tests, to save time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Let only one worker import a test module at a time, so that only the first compiles it."""
    if not isinstance(collector, pytest.Module):
        return (yield)
    with collector.path.open() as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        return (yield)


def pytest_collection_modifyitems(items):
    """Put tests with the mark ``realtime`` first; without ``--full``, skip long tests.

    Tests with the mark ``realtime`` mostly wait. One worker runs all of them while the other
    workers run other tests.
    """
    items.sort(key=lambda item: "realtime" not in item.keywords)
    if not full.WHOLE:
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="long: pass --full to pytest"))


def pytest_collection_finish():
    """Exempt modules and tests, which exist until the end, from garbage collection."""
    gc.collect()
    gc.freeze()
    # Each run only checks whether objects are frozen. It would be slow to count them.
    gc.get_freeze_count = lambda: 1


@pytest.fixture(autouse=True)
def own_state(tmp_path_factory, monkeypatch):
    """Give each test its own state folder, so that no test sees or stops boards of another test."""
    folder = tmp_path_factory.getbasetemp() / f"state{next(_STATES)}"
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))


@pytest.fixture(scope="session")
def realtime_lock(tmp_path_factory, worker_id):
    """Yield a lock file that all pytest workers share."""
    folder = tmp_path_factory.getbasetemp()
    shared = folder if worker_id == "master" else folder.parent
    with (shared / "realtime.lock").open("w") as file:
        yield file


@pytest.fixture(autouse=True)
def one_at_a_time(request):
    """Run only one test with the mark ``realtime`` at a time, in all pytest workers together."""
    if "realtime" not in request.keywords:
        yield
        return
    file = request.getfixturevalue("realtime_lock")
    fcntl.flock(file, fcntl.LOCK_EX)
    # A test thread of normal priority that holds the GIL would delay the threads of a run.
    with prioritized():
        yield
    fcntl.flock(file, fcntl.LOCK_UN)


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Limit libraries to one thread, because tests already run in several processes."""
    cv2.setNumThreads(1)
    with threadpool_limits(limits=1, user_api="blas"), pytest.MonkeyPatch.context() as patch:
        # Programs that tests start read these variables.
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        patch.setenv("OPENCV_FOR_THREADS_NUM", "1")
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        # All tests share the font list of matplotlib, because making this list is slow.
        fonts = Path.home() / ".cache" / "matplotlib"
        patch.setenv("MPLCONFIGDIR", os.environ.get("MPLCONFIGDIR", str(fonts)))
        yield


@pytest.fixture(scope="session", autouse=True)
def forked_emulators(one_thread):
    """Fork the emulator of each ``emulator:`` board of this process, because a fork is fast."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smarttouch.emulator.drivers.subprocess", processes.forked_boards())
        yield
    processes.Forked.end()


@pytest.fixture(scope="session", autouse=True)
def safety_watch():
    """Yield the watch. It checks delivery logs and the gates of this process with the oracle."""
    watch = Watch()
    patch = watch.installed()
    yield watch
    patch.undo()


@pytest.fixture
def judges_books():
    """Return True: check the delivery logs in each test's folder. Some modules override this."""
    return True


@pytest.fixture(autouse=True)
def proved_twice(request, safety_watch, judges_books):
    """Fail a test if the oracle refuses what a gate accepted, or pulses in a delivery log."""
    safety_watch.on = "row" not in request.fixturenames
    yield
    # A test without the fixture ``tmp_path`` writes no delivery log.
    if judges_books and "tmp_path" in request.node.funcargs:
        safety_watch.judge_books(request.node.funcargs["tmp_path"])
    assert safety_watch.take() == []


@pytest.fixture
def runs(request):
    """Return the value of option ``--runs``, or None."""
    return request.config.getoption("runs")


@pytest.fixture(scope="session")
def profile():
    return load_profile(DEFAULT_PROFILE)


@pytest.fixture(scope="session")
def bank(profile):
    from smarttouch.kernels.bank import load_bank

    return load_bank(profile)


@pytest.fixture(scope="session")
def make_bank():
    """Return a function that makes an RA bank from two (E, E) arrays, weights and receptor."""
    from smarttouch.base.afferent import Afferent
    from smarttouch.kernels.bank import KernelBank

    def make(weights, receptor):
        figures = ("off_target", "worst_class", "spill", "gap", "seconds")
        nothing = {name: {Afferent.RA: np.zeros(len(weights))} for name in figures}
        return KernelBank({Afferent.RA: weights}, receptor={Afferent.RA: receptor}, **nothing)

    return make


@pytest.fixture(scope="session")
def changed():
    """Return a function that copies a profile with new values of keys such as ``skin.medium``."""
    return attacked_profiles.changed


@pytest.fixture
def usb_ports(monkeypatch):
    """Return a function that adds a USB device to the ports that pyserial lists."""
    listed = []

    def tell(device, *, vid, pid, serial_number, location="1-1"):
        told = SimpleNamespace(
            device=device, vid=vid, pid=pid, serial_number=serial_number, location=location
        )
        listed.append(told)

    monkeypatch.setattr("smarttouch.base.wire.port.list_ports.comports", lambda: list(listed))
    return tell


@pytest.fixture
def make_frame():
    """Return a function that makes a frame from an image, a time and a force."""

    def make(image, time_ns=0, force_n=1.0):
        return Frame(np.asarray(image, np.uint8), time_ns, Pose(0.0, 0.0), force_n)

    return make


@pytest.fixture(scope="session")
def patch():
    """Return a function that makes an image of 64 x 64 pixels: a dark vertical bar on paper."""

    def make(first=24, last=40, paper=220, ink=30):
        image = np.full((64, 64), paper, np.uint8)
        image[:, first:last] = ink
        return image

    return make


@pytest.fixture(scope="session")
def other_account():
    """Return a function that runs Python as user nobody; skip the test if this is impossible."""
    try:
        account = importlib.import_module("pwd").getpwnam("nobody")
    except KeyError:
        pytest.skip("needs a second account: the system has no user nobody")
    if os.geteuid() != 0 or account.pw_uid == 0:
        pytest.skip("needs a second account: run pytest as root to switch users")

    def starter(python):
        @contextmanager
        def start(*arguments):
            process = subprocess.Popen(
                [python, "-I", *map(str, arguments)], user=account.pw_uid, group=account.pw_gid,
                extra_groups=(), cwd="/", stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            try:
                yield process
            finally:
                process.kill()
                process.communicate()

        return start

    # If user nobody cannot run this Python, use the system's: no packages are needed.
    for start in map(starter, (sys.executable, "/usr/bin/python3")):
        with suppress(OSError), start("-c", "import json") as process:
            if process.wait(60) == 0:
                return start
    pytest.skip("needs a second account: user nobody has no access to Python")
