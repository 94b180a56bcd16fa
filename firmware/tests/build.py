"""The firmware, built once for all tests, where there is a compiler."""

import shutil
import subprocess
import tempfile
import zlib
from functools import cache
from pathlib import Path

import pytest

from smarttouch.base.posix import fcntl

SOURCES = Path(__file__).parents[1]


@cache
def built(target, name, *programs, more=""):
    """Return a file that ``make`` builds; skip where there is none of its programs."""
    for program in ("make", *programs):
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}")
    if not SOURCES.is_dir():
        pytest.skip("needs the folder firmware")
    # Of these very sources: another's build may lie beside it.
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
    """Return a number of the sources' names, contents and place."""
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
    """Build a copy of the sources in which a text is another by ``cc`` with
    these options and further sources. Skip where that cannot be."""
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
