"""Runs are found by who wants to stop them, whatever lies beside them."""

import errno
import fcntl
import os
import signal
import subprocess
import sys
import time

import pytest

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.stopping import RunStopped
from smarttouch.boards import announced as module
from smarttouch.boards.announced import (
    Announcement,
    leave_mark,
    refuse_if_stopped,
    running,
    started_ns,
)
from smarttouch.boards.stoppable import announced

from ..raising import raises
from .test_stoppable import in_child


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "state" / "smarttouch"
    path.mkdir(parents=True)
    return path


def test_a_run_is_found_as_long_as_it_lasts(folder):
    assert running() == []
    with announced():
        assert running() == [os.getpid()]
    assert running() == []
    assert list(folder.iterdir()) == []


def litter(folder):
    """Leave whatever may lie there; return what must still be there."""
    (folder / "notes.txt").write_text("stray")
    (folder / "abc.run").write_text("no number")
    (folder / "-1.run").write_text("no process")
    (folder / "11.run").write_text("no time")
    (folder / "٣-1.run").write_text("a number of other digits")
    (folder / "12-1.run.old").write_text("")
    (folder / "13-1.run").mkdir()
    os.mkfifo(folder / "14-1.run")
    (folder / "15-1.run").symlink_to(folder / "14-1.run")
    (folder / "16-1.run").symlink_to(folder / "nowhere")
    (folder / "17-1.run").write_text("unreadable")
    (folder / "17-1.run").chmod(0)
    (folder / "18-1.run").symlink_to("/dev/zero")
    os.mkfifo(folder / ".new")
    # Of a run that was killed, or readable all the same: nobody holds it.
    return {each.name for each in folder.iterdir()} - {"17-1.run"}


def test_whatever_lies_beside_them_is_passed_over(folder):
    left = litter(folder)
    with announced():
        assert running() == [os.getpid()]
        mark = f"stopped-{leave_mark()}"
    assert {each.name for each in folder.iterdir()} - {"17-1.run"} == left | {mark}


def test_files_of_runs_that_were_killed_are_removed(folder):
    (folder / "4194305-1.run").write_text("")
    assert running() == []
    assert list(folder.iterdir()) == []


def test_removing_the_file_of_a_run_that_ended_leaves_the_next_of_that_process(monkeypatch):
    before, after = Announcement(), []

    def end_and_begin(number, how):
        if how & fcntl.LOCK_SH and not after:
            before.withdraw()
            after.append(None)
            after[0] = Announcement()
        flock(number, how)

    flock = fcntl.flock
    monkeypatch.setattr(module.fcntl, "flock", end_and_begin)
    running()
    assert running() == [os.getpid()]
    after[0].withdraw()


def test_who_has_ended_since_it_was_found_gets_no_signal(monkeypatch):
    """It may be another program by now, or do what must not be cut short."""
    signals, ask = [], module._ask_to_stop
    monkeypatch.setattr(module.os, "kill", lambda *told: signals.append(told))
    announcement = Announcement(lambda: None)
    monkeypatch.setattr(module, "_ask_to_stop", lambda path: (announcement.withdraw(), ask(path)))
    assert module.stop_all() == 1
    assert signals == []


def test_a_process_of_the_same_number_is_another(folder):
    """As in another container that shares the folder."""
    announcement = Announcement(lambda: None)
    announcement.declare(5000)
    with (folder / f"{os.getpid()}-1.run").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write("7000")
        file.flush()
        assert announcement.others_ua() == 7000
    announcement.withdraw()


def test_a_run_that_cannot_be_announced_does_not_begin(folder, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space left", str(folder / "1.stop"))

    monkeypatch.setattr(os, "mkfifo", full)
    with raises(SmartTouchError, value=folder / "1.stop"):
        Announcement(lambda: None)
    assert list(folder.iterdir()) == []


def test_a_process_older_than_the_mark_does_not_begin(folder):
    refuse_if_stopped()
    leave_mark()
    with pytest.raises(RunStopped) as caught:
        refuse_if_stopped()
    assert caught.value.number == signal.SIGTERM


def test_a_process_younger_than_the_mark_begins(folder):
    leave_mark()
    time.sleep(0.03)
    code = "from smarttouch.boards.announced import refuse_if_stopped; refuse_if_stopped()"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_what_a_program_older_than_the_mark_forks_does_not_begin(folder):
    """As a worker of an experiment that was between two of them when it was stopped."""
    leave_mark()
    time.sleep(0.03)

    def begin(say):
        with pytest.raises(RunStopped):
            refuse_if_stopped()
        say()

    with in_child(begin) as child:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_the_start_of_this_process_is_never_too_late():
    before = now_ns()

    def work(say):
        assert before - 20_000_000 < started_ns() <= now_ns()
        say()

    with in_child(work) as child:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert started_ns() < before


def test_where_the_system_has_no_start_time_it_is_the_import(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "_OWN_STAT", tmp_path / "nothing")
    assert started_ns() == module._IMPORTED_NS
    assert started_ns() < now_ns()


@pytest.mark.parametrize("text", ["", "x", "\udce4 5", "9" * 1000])
def test_an_empty_mark_is_none(folder, text):
    (folder / "stopped-5").write_bytes(text.encode("utf-8", "surrogateescape"))
    refuse_if_stopped()


@pytest.mark.parametrize("name", ["stopped", "stopped-", "stopped-x", "stopped--5", "stopped-٣"])
def test_nor_is_one_without_a_time(folder, name):
    (folder / name).write_text(module._boot())
    refuse_if_stopped()


def test_marks_of_another_start_of_the_machine_and_of_the_future_do_not_count(folder):
    time_ns = now_ns()
    (folder / f"stopped-{time_ns}").write_text("another")
    (folder / f"stopped-{time_ns + 10**12}").write_text(module._boot())
    refuse_if_stopped()
    (folder / f"stopped-{time_ns}").write_text(module._boot())
    with pytest.raises(RunStopped):
        refuse_if_stopped()


def test_one_mark_remains_and_it_is_the_newest_also_of_stops_at_once(folder, monkeypatch):
    marks, new_file = [], module._new_file

    def overtaken():
        monkeypatch.setattr(module, "_new_file", new_file)
        marks.append(leave_mark())
        return new_file()

    leave_mark()
    monkeypatch.setattr(module, "_new_file", overtaken)
    assert leave_mark() < marks[0]
    assert max(module._marks().values()) == marks[0]
    marks.append(leave_mark())
    assert [each.name for each in folder.iterdir()] == [f"stopped-{marks[1]}"]


@pytest.mark.parametrize("kind", ["fifo", "link", "folder"])
def test_what_has_the_name_of_a_mark_is_none(folder, kind):
    path = folder / "stopped-5"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "link":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    refuse_if_stopped()
    leave_mark()
    with pytest.raises(RunStopped):
        refuse_if_stopped()
