"""Tests that modules import without warnings, also on a system without POSIX functions."""

import subprocess
import sys

import pytest

ALL_MODULES = """
import importlib, pkgutil, smarttouch
names = [found.name for found in pkgutil.walk_packages(smarttouch.__path__, "smarttouch.")]
for name in names:
    importlib.import_module(name)
print(*names)
"""


NOT_POSIX = """
import builtins, contextlib, ctypes, functools, os, pathlib, signal, socket, sys
with contextlib.suppress(ImportError):
    import psutil  # joblib uses it, if installed; it needs functions removed below
real, only_posix = builtins.__import__, {"fcntl", "pty", "resource", "termios", "tty"}
def imported(name, globals=None, *rest, **named):
    if name in only_posix and (globals or {}).get("__name__", "").startswith("smarttouch"):
        raise ImportError(name)
    return real(name, globals, *rest, **named)
builtins.__import__ = imported
for name in "SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGALRM":
    delattr(signal, name)
gone = {"fork", "openpty", "setsid", "mkfifo", "killpg", "set_blocking", "geteuid", "fchmod"}
gone |= {"pread", "pwrite"}  # not sysconf: other libraries call it on Linux
gone |= {"O_NONBLOCK", "O_NOCTTY", "O_NOFOLLOW", "O_CLOEXEC", "O_DIRECTORY", "getpgid", "ttyname"}
for name in [name for name in dir(os) if name in gone or name.startswith(("sched_", "SCHED_"))]:
    delattr(os, name)
ctypes.PyDLL = None
pair = functools.partial(socket.socketpair, socket.AF_UNIX)
socket.socketpair = lambda: pair()  # Windows has no Unix family, but socketpair()
for name in "AF_UNIX", "SO_PEERCRED", "SO_PASSCRED", "MSG_DONTWAIT", "CMSG_SPACE":
    delattr(socket, name)
exists = pathlib.Path.exists
pathlib.Path.exists = lambda path: not str(path).startswith("/proc/") and exists(path)
"""

FAKE_PORT = """
import threading, time, types, serial
from smarttouch.emulator.firmware_base import DeliveryLog, DeviceClock
from smarttouch.emulator.link_board import LinkFirmware
class FakePort(serial.SerialBase):
    log = DeliveryLog(64)
    def open(self):
        self._board, self._waiting = LinkFirmware("weighted", self.log), b""
        self._clock, self._lock = DeviceClock(self._board.longest_step_ns), threading.RLock()
        self.is_open = True
    def _reconfigure_port(self): pass
    def close(self): self.is_open = False
    def reset_input_buffer(self): self.read(self.in_waiting)
    @property
    def in_waiting(self):
        with self._lock:
            self._waiting += self._board.advance(self._clock.now_ns())
            return len(self._waiting)
    def write(self, data):
        with self._lock:
            self._waiting += self._board.feed(bytes(data), self._clock.now_ns())
    def read(self, count=1):
        end_s = time.monotonic() + self.timeout
        while self.in_waiting < count and time.monotonic() < end_s:
            time.sleep(0.001)
        with self._lock:
            data, self._waiting = self._waiting[:count], self._waiting[count:]
        return data
sys.modules["serial.urlhandler.protocol_fake"] = types.SimpleNamespace(Serial=FakePort)
"""

RUN = """
import smarttouch as st
from smarttouch.cli import main
profile = st.load_profile("electric-mouse")
with st.open_source("text:a", profile) as source, st.open_display("simulated:", profile) as display:
    figures = st.run(source, display, seconds=0.3, listeners=[st.Recorder("run.mcap")]).figures
assert figures["emulator_violations"] == 0
print(figures["sequences"])
assert len(st.load_recording("run.mcap").arrays.step) == figures["sequences"]
run = {"force": "fixed:0.5", "seconds": 1.0, "intensity": 0.3}
done = st.run("text:a", "link:fake://", **run)
log = FakePort.log
assert (log.state, log.reason, log.unsafe) == ("shorted", "stop", 0), log
assert log.pulses > 100, log
for url in "emulator:", "etactilekit:/dev/ttyUSB0":
    try:
        st.run("text:a", url, **run)
    except st.BoardError as error:
        assert "simulated:" in str(error), error
    else:
        raise AssertionError(url + " opened without POSIX")
try:
    st.open_source("socket:./place", profile)
except st.SourceError as error:
    assert "no Unix sockets" in str(error), error
else:
    raise AssertionError("a Unix socket opened without POSIX")
sys.argv = ["smarttouch", "design", "27", "--mode", "RA", "--json", "kernels.json"]
main()
sys.argv = ["smarttouch", "replay", "run.mcap", "--info"]
main()
"""


@pytest.mark.long
def test_no_module_and_no_run_on_simulated_or_link_needs_what_only_posix_has(tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", NOT_POSIX + ALL_MODULES + FAKE_PORT + RUN],
        capture_output=True, text=True, timeout=100, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    names, sequences, *_ = done.stdout.splitlines()
    assert {"smarttouch.cli", "smarttouch.emulator.__main__"} <= {*names.split()}
    assert int(sequences) > 5
    assert (tmp_path / "run.mcap").stat().st_size > 10_000
