"""Every module can be imported, and no import warns."""

import subprocess
import sys

ALL_MODULES = """
import importlib, pkgutil, smarttouch
names = [found.name for found in pkgutil.walk_packages(smarttouch.__path__, "smarttouch.")]
for name in names:
    importlib.import_module(name)
print(*names)
"""


NOT_POSIX = """
import builtins, os, signal
real, only_posix = builtins.__import__, {"fcntl", "pty", "resource", "termios", "tty"}
def imported(name, globals=None, *rest):
    if name in only_posix and (globals or {}).get("__name__", "").startswith("smarttouch"):
        raise ImportError(name)
    return real(name, globals, *rest)
builtins.__import__ = imported
del signal.SIGHUP
for name in [name for name in dir(os) if name.startswith(("sched_", "SCHED_"))]:
    delattr(os, name)
"""


def test_every_module_is_imported_without_what_only_posix_has():
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", NOT_POSIX + ALL_MODULES],
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert {"smarttouch.cli", "smarttouch.wire.port"} <= {*done.stdout.split()}


def test_every_module_is_imported():
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ALL_MODULES],
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert {"smarttouch.cli", "smarttouch.emulator.__main__"} <= {*done.stdout.split()}
