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


def test_every_module_is_imported():
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ALL_MODULES],
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert {"smarttouch.cli", "smarttouch.emulator.__main__"} <= {*done.stdout.split()}
