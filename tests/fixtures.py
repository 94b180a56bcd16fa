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

from .safety import displays
from .safety.watch import Watch
from .support import full, processes

_STATES = itertools.count()

# What a script runs in the background is deaf to Ctrl-C, and so would be all that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Compiling the tests and the package takes longer than many a test, and each program that tests
# start would do it again where the environment forbids to keep what was compiled.
sys.dont_write_bytecode = False


def pytest_addoption(parser):
    parser.addoption(
        "--full", action="store_true", help="run all of what is sampled otherwise, as CI does"
    )
    parser.addoption(
        "--runs", type=int, help="of tests that repeat something at random: how often, or how long"
    )


def pytest_configure(config):
    full.configure(config)
    # How long an example takes says how busy the machine is, and nothing of the code. In CI the
    # examples are the same each time: what fails there is a change, and can be seen again.
    examples, always_alike = 100 if full.WHOLE else 25, "CI" in os.environ
    settings.register_profile(
        "smarttouch", deadline=None, max_examples=examples, derandomize=always_alike
    )
    settings.load_profile("smarttouch")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Let nothing look for garbage among tests and modules that are just being made."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(items):
    """Let the tests of time that passes come first; of the others, each stays in its place.

    So one worker has them all, and no two run beside each other. They mostly wait: at the end
    of a run its processors would wait with them.
    """
    items.sort(key=lambda item: "realtime" not in item.keywords)
    if not full.WHOLE:
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="long: with --full, as in .ci/run"))


def pytest_collection_finish():
    """Let the garbage collector pass over what the whole run needs: modules and tests."""
    gc.collect()
    gc.freeze()
    # Each run would count them.
    gc.get_freeze_count = lambda: 1


@pytest.fixture(autouse=True)
def own_state(tmp_path_factory, monkeypatch):
    """Let no board of one test count, or be stopped, in another; it is made when it is needed."""
    folder = tmp_path_factory.getbasetemp() / f"state{next(_STATES)}"
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))


@pytest.fixture(scope="session")
def realtime_lock(tmp_path_factory, worker_id):
    """A file that all workers of a run share."""
    folder = tmp_path_factory.getbasetemp()
    shared = folder if worker_id == "master" else folder.parent
    with (shared / "realtime.lock").open("w") as file:
        yield file


@pytest.fixture(autouse=True)
def one_at_a_time(request):
    """Let no two tests of time that passes run beside each other, however few are run."""
    if "realtime" not in request.keywords:
        yield
        return
    file = request.getfixturevalue("realtime_lock")
    fcntl.flock(file, fcntl.LOCK_EX)
    # As a run has it: whoever holds the interpreter's lock at another holds up those that pace.
    with prioritized():
        yield
    fcntl.flock(file, fcntl.LOCK_UN)


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Tests run beside each other: threads of one would wait for those of another."""
    cv2.setNumThreads(1)
    with threadpool_limits(limits=1, user_api="blas"), pytest.MonkeyPatch.context() as patch:
        # For the programs that tests start.
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        patch.setenv("OPENCV_FOR_THREADS_NUM", "1")
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        # Tests have caches of their own for kernels; the list of fonts is made once.
        fonts = Path.home() / ".cache" / "matplotlib"
        patch.setenv("MPLCONFIGDIR", os.environ.get("MPLCONFIGDIR", str(fonts)))
        yield


@pytest.fixture(scope="session", autouse=True)
def forked_emulators(one_thread):
    """Let each ``emulator:`` of this process start a fork."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smarttouch.emulator.emulated_boards.subprocess", processes.forked_boards())
        yield
    processes.Forked.end()


@pytest.fixture(scope="session", autouse=True)
def safety_watch():
    """The oracle beside every gate of this process, and its judge of books."""
    watch = Watch()
    patch = watch.installed()
    yield watch
    patch.undo()


@pytest.fixture
def judges_books():
    """True where the books that a test leaves in its folder are of what a gate has proved."""
    return True


@pytest.fixture(autouse=True)
def proved_twice(request, safety_watch, judges_books):
    """Fail a test if a gate accepts, or an emulator delivers, what the oracle would not."""
    safety_watch.on = "row" not in request.fixturenames
    yield
    # Whoever has no folder leaves no books.
    if judges_books and "tmp_path" in request.node.funcargs:
        safety_watch.judge_books(request.node.funcargs["tmp_path"])
    assert safety_watch.take() == []


@pytest.fixture
def runs(request):
    """Return the number of ``--runs``, or None."""
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
    """Return a maker of RA banks from weights and receptors alone, (E, E) each."""
    from smarttouch.base.afferent import Afferent
    from smarttouch.kernels.bank import KernelBank

    def make(weights, receptor):
        figures = ("off_target", "worst_class", "spill", "gap", "seconds")
        nothing = {name: {Afferent.RA: np.zeros(len(weights))} for name in figures}
        return KernelBank({Afferent.RA: weights}, receptor={Afferent.RA: receptor}, **nothing)

    return make


@pytest.fixture(scope="session")
def changed():
    """Return a maker of profiles that differ from one in keys such as ``skin.medium``."""
    return displays.changed


@pytest.fixture
def usb_ports(monkeypatch):
    """Return a setter of the USB description of a device, as pyserial lists it."""
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
    """Return a maker of frames: an image, a time and a force."""

    def make(image, time_ns=0, force_n=1.0):
        return Frame(np.asarray(image, np.uint8), time_ns, Pose(0.0, 0.0), force_n)

    return make


@pytest.fixture(scope="session")
def patch():
    """Return a maker of 64 x 64 patches: white paper with one black bar of columns."""

    def make(first=24, last=40, paper=220, ink=30):
        image = np.full((64, 64), paper, np.uint8)
        image[:, first:last] = ink
        return image

    return make


@pytest.fixture(scope="session")
def other_account():
    """Return a starter of Python programs as the user nobody; skip where there is none to be."""
    try:
        account = importlib.import_module("pwd").getpwnam("nobody")
    except KeyError:
        pytest.skip("there is no second account: no user nobody")
    if os.geteuid() != 0 or account.pw_uid == 0:
        pytest.skip("there is no second account: only root can be another user")

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

    # Ours may lie in a home that nobody else can enter; what they run needs no packages.
    for start in map(starter, (sys.executable, "/usr/bin/python3")):
        with suppress(OSError), start("-c", "import json") as process:
            if process.wait(60) == 0:
                return start
    pytest.skip("there is no second account: nobody cannot run Python")
