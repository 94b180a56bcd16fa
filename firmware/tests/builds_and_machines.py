"""Builds of the firmware, shared by all tests, and machines emulated by QEMU. For a Cortex-M3
there is a delivery log, as for the Python emulator."""

import contextlib
import shutil
import socket
import subprocess
import tempfile
import threading
import time
import zlib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.posix import fcntl
from smarttouch.boards.link import OUTPUTS
from smarttouch.emulator.firmware_base import DeliveryLog
from smarttouch.emulator.skin import Delivered

SOURCES = Path(__file__).parents[1]


@cache
def built(target, name, *programs, more=""):
    """Build a file by ``make`` and return it; skip the test if ``make`` or a program is missing."""
    for program in ("make", *programs):
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}")
    if not SOURCES.is_dir():
        pytest.skip("needs the folder firmware")
    # The name depends on the sources, because other checkouts build in the same folder.
    number = zlib.crc32(more.encode(), hash_of_sources())
    folder = Path(tempfile.gettempdir()) / f"smarttouch-firmware-{number:x}"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        command = ["make", "--silent", "-C", str(SOURCES), f"BUILD={folder}", target]
        command += [f"MORE={more}"] * bool(more)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / name


def hash_of_sources():
    """Return a CRC of the contents and the folder of the sources."""
    found = zlib.crc32(str(SOURCES).encode())
    for path in sorted(SOURCES.rglob("*")):
        if (
            path.suffix in {".c", ".h", ".ld", ".ino", ""}
            and path.is_file()
            and "build" not in path.parts
        ):
            found = zlib.crc32(path.read_bytes(), found)
    return found


def changed(folder, file, old, new, *options):
    """Replace ``old`` by ``new`` in a copy of the sources, and build the copy with ``cc``.
    ``options`` may contain further sources. Skip the test if sources or ``cc`` are missing."""
    if not SOURCES.is_dir() or shutil.which("cc") is None:
        pytest.skip("needs the folder firmware and cc")
    copy = shutil.copytree(SOURCES, folder / "firmware")
    source = copy / "src" / file
    text = source.read_text(encoding="utf-8")
    assert text.count(old) == 1
    source.write_text(text.replace(old, new), encoding="utf-8")
    files, found = [*copy.glob("src/*.c")], folder / "built.so"
    options = [copy / each if each.endswith(".c") else each for each in options]
    command = ["cc", "-O1", f"-I{copy / 'src'}", *options, *files, "-o", found]
    subprocess.run(command, check=True)
    return found


def library():
    return built("library", "libst.so", "cc")


def host():
    return built("host", "st_host", "cc")


def cortex_m3(more=""):
    programs = ("arm-none-eabi-gcc", "qemu-system-arm")
    return built("qemu", "st_m3.elf", *programs, more=more)


ELECTRODES = 64
_REASONS = {word[:4]: word for word in ("start", "end", "silence", "stop", "begin", "emergency")}


def trace_of(electrodes):
    """Return the NumPy type of a trace record: a pulse, or the shorting of all electrodes."""
    return np.dtype(
        [("number", "<u4"), ("start_us", "<u4"), ("slot", "<u2"), ("site", "<u2"),
         ("width_us", "<u2"), ("source_ua", "<u2"), ("current_ua", "<i2", electrodes)]
    )  # fmt: skip


class OverSocket:
    """Board at the other end of a socket, with the methods that `Talk` calls."""

    def __init__(self, line):
        self.line = line
        line.settimeout(10)

    def feed(self, data, _now_us):
        self.line.sendall(data)
        answer = b""
        while not answer.endswith(b"\0"):
            answer += self.line.recv(65536)
        return answer, []


class Machine:
    """Machine emulated by QEMU, with a socket as serial port; ``name`` is the port's URL."""

    def __init__(self, kind, elf, begun, *options):
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        self._port, self.name = port, f"socket://127.0.0.1:{port}"
        command = ["qemu-system-arm", "-M", kind, "-kernel", elf, "-display", "none", "-monitor",
                   "none", "-serial", f"tcp:127.0.0.1:{port},server=on,wait=off,nodelay=on",
                   *options]  # fmt: skip
        self.process = subprocess.Popen(command, start_new_session=True)
        for _ in range(6000):
            if begun():
                break
            time.sleep(0.01)

    @contextlib.contextmanager
    def connected(self):
        with socket.create_connection(("127.0.0.1", self._port)) as line:
            yield OverSocket(line)

    def close(self):
        self.process.kill()
        self.process.wait()


class CortexM3(Machine):
    """Cortex-M3. If ``stands_after`` is N, the processor hangs in pulse N, and a watchdog timer
    resets it. With ``counts``, its clock counts instructions of 8 ns. A busy computer then delays
    no slot, but the port is slower."""

    def __init__(
        self, folder, electrodes=ELECTRODES, output="weighted", ramp_ms=500, stands_after=0,
        counts=False,
    ):  # fmt: skip
        self._trace, self._type = folder / "trace.bin", trace_of(electrodes)
        words = electrodes, OUTPUTS.index(output), ramp_ms, stands_after
        words = ",".join(f"arg={each}" for each in words)
        elf = cortex_m3(" -DST_WATCHDOG -DST_SILENCE_US=500000u" * bool(stands_after))
        # At start, the firmware writes its first record: all electrodes are shorted.
        super().__init__(
            "mps2-an385", elf, lambda: len(self.records()), *["-icount", "shift=3"] * counts,
            "-semihosting-config", f"enable=on,arg=board,{words}", "-serial", f"file:{self._trace}",
        )  # fmt: skip
        self._books = Books(folder, electrodes, output, self.records)

    def close(self):
        super().close()
        self._books.close()

    def records(self, start=0):
        """Return all records from number ``start`` on."""
        size, data = self._type.itemsize, b""
        with contextlib.suppress(FileNotFoundError), self._trace.open("rb") as file:
            file.seek(start * size)
            data = file.read()
        return np.frombuffer(data[: len(data) // size * size], self._type)

    def pulses(self):
        """Return the records of pulses so far."""
        records = self.records()
        return records[records["width_us"] > 0]


class Books:
    """Delivery log that a thread writes from the records of a machine."""

    def __init__(self, folder, electrodes, output, records):
        self._log, self._records = DeliveryLog(electrodes, folder), records
        self._switched = output != "weighted"
        self._read, self._ended = 0, threading.Event()
        self._log.write()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join()

    def _follow(self):
        while not self._ended.wait(0.02):
            new = self._records(self._read)
            self._read += len(new)
            for record in new:
                self._enter(record)
            self._log.write()

    def _enter(self, record):
        log, width_us = self._log, int(record["width_us"])
        if not width_us:
            word = record["number"].tobytes().rstrip(b"\0").decode()
            log.state, log.reason = "shorted", _REASONS[word]
            log.zero_after_ms = (int(record["slot"]) + 65536 * int(record["site"])) / 1000
            log.violations = int(record["source_ua"])
            return
        current_ua = record["current_ua"].astype(float)
        if self._switched:
            for pole in (current_ua > 0, current_ua < 0):
                current_ua[pole] *= int(record["source_ua"]) / max(1, pole.sum())
        nothing = np.zeros(len(current_ua))
        delivered = Delivered(current_ua, current_ua * width_us, nothing, 0.0)
        number, slot, site, start_us = (
            int(record[name]) for name in ("number", "slot", "site", "start_us")
        )
        log.state = "driving"
        log.enter(number, slot, site, delivered, width_us, nothing, start_us)
