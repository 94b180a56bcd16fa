"""Users' files: only regular files up to a size are read; writing is atomic and private."""

import errno
import os
import re
import resource
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from smarttouch.base import files as module
from smarttouch.base.errors import PageError, ProfileError
from smarttouch.base.files import (
    make_folder,
    open_alone,
    open_file,
    read_bytes,
    read_csv,
    read_text,
    read_toml,
    require_file,
    require_replaceable,
    write_bytes,
)

from ..support.checks import raises


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_what_is_a_file_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfabc")
    (tmp_path / "link").symlink_to("a")
    assert read_bytes(tmp_path / "link", PageError) == b"\xef\xbb\xbfabc"
    assert read_text(tmp_path / "a", PageError) == "abc"
    with open_file(tmp_path / "a", PageError, 6) as file:
        assert not os.get_inheritable(file.fileno())
        assert file.read() == b"\xef\xbb\xbfabc"


def test_what_is_no_file_is_not_opened(tmp_path, pipe, monkeypatch):
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(tmp_path / "socket"))
    (tmp_path / "loop").symlink_to("loop")

    def refuse(*_):
        raise AssertionError("opened")

    monkeypatch.setattr(os, "open", refuse)
    names = ("socket", "loop", "none", "nul\0", "long" * 100, "none/x", "/dev/zero", "/dev/full")
    for path in (pipe, tmp_path, *(tmp_path / name for name in names)):
        with raises(ProfileError, value=path):
            read_bytes(path, ProfileError)
    listening.close()


def test_sizes(tmp_path):
    sparse = tmp_path / "sparse"
    with sparse.open("wb") as file:
        file.truncate(2**40)
    for check in (require_file, read_bytes):
        with raises(PageError, value=2**40, allowed=10**6) as error:
            check(sparse, PageError, 10**6)
        assert "1,099,511.6 MB" in str(error.value)
    (tmp_path / "a").write_bytes(b"abc")
    assert read_bytes(tmp_path / "a", PageError, 3) == b"abc"
    with raises(PageError):
        read_bytes(tmp_path / "a", PageError, 2)


def test_what_is_no_text(tmp_path):
    (tmp_path / "a").write_bytes(b"abc\xff")
    with raises(PageError, value=tmp_path / "a") as error:
        read_text(tmp_path / "a", PageError)
    assert "byte 4" in str(error.value)


@pytest.mark.parametrize("text", ["a = ", "a = 1\na = 2", "a = " + "[" * 100_000])
def test_what_is_no_toml(tmp_path, text):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ProfileError, match=re.escape(str(path))):
        read_toml(path, ProfileError)


def test_writing(tmp_path, pipe):
    write_bytes(tmp_path / "a", b"longer")
    write_bytes(tmp_path / "a", b"abc")
    assert (tmp_path / "a").read_bytes() == b"abc"
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_bytes(pipe, b"through")
    assert os.read(reader, 99) == b"through"
    os.close(reader)


def test_standard_output_that_is_a_file_keeps_what_it_has(tmp_path):
    code = (
        "from pathlib import Path; from smarttouch.base.files import write_bytes\n"
        "print('before', flush=True)\nwrite_bytes(Path('/dev/stdout'), b'figures')"
    )
    with (tmp_path / "a").open("wb") as output:
        subprocess.run([sys.executable, "-c", code], stdout=output, check=True)
    assert (tmp_path / "a").read_bytes() == b"before\nfigures"


def test_what_cannot_be_written(tmp_path):
    places = (
        (tmp_path, errno.EISDIR), (tmp_path / "none" / "a", errno.ENOENT),
        (tmp_path / "nul\0", None), (Path("/dev/full"), errno.ENOSPC),
    )  # fmt: skip
    for path, number in places:
        with raises(PageError, value=path) as error:
            write_bytes(path, b"abc", PageError)
        assert number is None or os.strerror(number) in str(error.value)


def test_what_could_not_be_written_whole_replaces_nothing(tmp_path):
    path, before = tmp_path / "a", resource.getrlimit(resource.RLIMIT_FSIZE)
    write_bytes(path, b"old")
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with raises(PageError, value=path):
            write_bytes(path, b"new, and too long", PageError)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_device_is_not_replaced_by_a_file(tmp_path, pipe):
    (tmp_path / "a").touch()
    require_replaceable(tmp_path / "a", PageError)
    require_replaceable(tmp_path / "none", PageError)
    for path in (pipe, tmp_path, Path("/dev/null")):
        with pytest.raises(PageError):
            require_replaceable(path, PageError)


@pytest.fixture
def umask():
    """Set the umask to 0: new files are open to everybody unless the program sets a mode."""
    before = os.umask(0)
    yield
    os.umask(before)


def alone(path, data):
    with open_alone(path, PageError) as file:
        file.write(data)


@pytest.mark.parametrize("write", [write_bytes, alone])
@pytest.mark.parametrize("before", [None, 0o600, 0o644, 0o666])
def test_what_is_written_is_for_its_owner_alone(tmp_path, umask, write, before):
    path = tmp_path / "a"
    if before is not None:
        path.write_bytes(b"old, and longer")
        path.chmod(before)
        (tmp_path / "link").symlink_to(path)
        path = tmp_path / "link"
    write(path, b"new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert path.read_bytes().startswith(b"new")


def test_folders_are_for_their_owner_alone(tmp_path, umask):
    tmp_path.chmod(0o755)
    for _ in range(2):
        make_folder(tmp_path / "a" / "b")
    modes = [stat.S_IMODE((tmp_path / each).stat().st_mode) for each in (".", "a", "a/b")]
    assert modes == [0o755, 0o700, 0o700]
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "b"):
        with pytest.raises(OSError):
            make_folder(path)


def test_a_lock_on_a_file_that_was_removed_keeps_nobody_out(tmp_path, monkeypatch):
    """A file that was removed between opening and locking is replaced by a new, locked file."""
    path, flock = tmp_path / "lock", module.fcntl.flock
    path.write_bytes(b"old")
    removed = []

    def late(file, how):
        if not removed:
            removed.append(path.unlink())
        flock(file, how)

    monkeypatch.setattr(module.fcntl, "flock", late)
    with open_alone(path, PageError) as file:
        assert removed
        assert file.read() == b""
        assert os.path.samestat(os.fstat(file.fileno()), path.stat())
        with raises(PageError, value=path):
            open_alone(path, PageError)


def test_a_file_system_without_locks_lets_everybody_in(tmp_path, monkeypatch):
    def without(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(module.fcntl, "flock", without)
    with open_alone(tmp_path / "a", PageError), open_alone(tmp_path / "a", PageError) as second:
        assert second.writable()


@pytest.fixture
def table(tmp_path):
    def read(text, *names, **how):
        path = tmp_path / "a.csv"
        path.write_text(text, encoding="utf-8", newline="")
        columns = read_csv(path, PageError, names, **how)
        return {name: column.tolist() for name, column in columns.items()}

    return read


def test_columns_come_in_the_order_asked_and_others_are_not_used(table):
    text = "\ufeff\nb, note ,a\r\n1, x,2\r\n\r\n , ,\r\n3,,4,\r\n"
    assert list(table(text, "a", "b").items()) == [("a", [2, 4]), ("b", [1, 3])]
    assert table(text, "a", optional=("c", "b")) == {"a": [2, 4], "b": [1, 3]}
    assert table('a,note\n2,"x\ny"\n1,z\n', "a", rising=False) == {"a": [2, 1]}


@pytest.mark.parametrize(("text", "about", "value"), [
    ("", "columns", ()), ("a,c\n1,2\n", "columns", ("a", "c")), ("a,b\n1,2\n", "rows", 1),
    ("a,b\n1,2\n\n2\n", "line", 4), ("a,b\n1,2\n2,\n", "line", 3),
    ("a,b\n1,2\n2,1e999\n", "line", 3), ("a,b\n0,5,1\n", "line", 2),
    ("a,b\n1,2\n3,4\n3,5\n", "line", 4), ("a,b\n1,2\n9,4\n7,5\n", "line", (4, 7, 9)),
    ('a,b\n1,"2\n"\nx,3\n', "line", 4),
])  # fmt: skip
def test_errors_of_tables_name_their_line(table, text, about, value):
    with raises(PageError, names=about, value=value):
        table(text, "a", "b")
