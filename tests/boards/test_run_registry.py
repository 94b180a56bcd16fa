"""A stop brings every real run to zero or names it, and touches no other process."""

import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import BoardError, BoardStoppedError, SmartTouchError
from smarttouch.boards import run_registry, shutdown
from smarttouch.boards.run_registry import registry_folder, stop_all, stopped_since_start

from ..raising import raises
from .fresh import until
from .runs import Display, exit_code, in_child, until_zero

ID = "0" * 32


@pytest.fixture
def folder(own_state):
    registry_folder().mkdir(mode=0o700, parents=True)
    return registry_folder()


@pytest.fixture
def bystander():
    """A process that has nothing to do with any run."""
    with subprocess.Popen(["sleep", "60"]) as process:
        yield process
        assert process.poll() is None
        process.kill()


def entries(folder):
    return [path for path in folder.iterdir() if path.suffix]


def described(pid, changes):
    """Return the file of a run as it would be written for a process."""
    host, boot, namespace = run_registry._place()
    fields = {"host": host, "boot": boot, "namespace": namespace, "pid": pid}
    start_ns = run_registry._start_ns(pid)
    return json.dumps(fields | {"start_ns": start_ns, "current_ua": 9_000} | changes)


def sentences():
    return [answer.sentence for answer in stop_all()]


def test_a_run_is_announced_as_long_as_it_lasts(folder):
    with Display():
        (file,) = folder.glob("*.json")
        (lock,) = folder.glob("*.lock")
        run = json.loads(file.read_text())
        assert (run["pid"], run["current_ua"]) == (os.getpid(), 10_000)
        for path in (file, lock):
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert entries(folder) == []


def test_a_run_answers_for_its_own_boards_alone(folder):
    """Whatever became of boards that this process had open before."""
    lost = Display()
    shutdown.enter(lost)
    shutdown.leave(lost, at_zero=False)
    for path in folder.glob("*.unconfirmed"):
        path.unlink()
    with Display():
        pass
    assert entries(folder) == []


def test_a_new_folder_is_for_its_owner_alone(own_state):
    with Display():
        assert stat.S_IMODE(registry_folder().stat().st_mode) == 0o700


def test_what_drives_nothing_real_needs_no_folder(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with Display(announced=False):
        pass
    with raises(SmartTouchError, names="XDG_STATE_HOME", value=tmp_path / "file"), Display():
        pass


def test_no_run_is_no_answer(own_state):
    assert stop_all() == []


@pytest.mark.parametrize(("boards", "at_zero"), [
    ([Display()], [True]),
    ([Display(), Display()], [True, True]),
    ([Display(confirms=False)], [False]),
    ([Display(confirms=False), Display(), Display(budget_ua=0)], [False, True, True]),
], ids=["one", "two", "unconfirmed", "one of three unconfirmed"])  # fmt: skip
def test_every_run_is_asked_and_says_whether_it_is_at_zero(folder, boards, at_zero):
    with ExitStack() as stack:
        children = [stack.enter_context(in_child(until_zero(board))) for board in boards]
        found = {answer.sentence.split()[1]: answer for answer in stop_all()}
        assert [found[str(child)].at_zero for child in children] == at_zero
        for child, confirmed in zip(children, at_zero, strict=True):
            assert ("switch the board off" in found[str(child)].sentence) != confirmed
        assert [exit_code(child) for child in children] == [7] * len(children)
    assert list(folder.glob("*.json")) == []


def test_a_request_that_fails_keeps_no_other_run_from_being_asked(folder):
    with in_child(until_zero(Display())) as one, in_child(until_zero(Display(), 3.0)) as other:
        for file in folder.glob("*.json"):
            if json.loads(file.read_text())["pid"] == other:
                # Where the request would be written, nothing can be.
                file.with_suffix(".stop").symlink_to(folder / "nowhere" / "file")
        answers = stop_all()
        assert [answer.at_zero for answer in answers] == [True, False]
        assert f"process {one} " in answers[0].sentence
        assert f"process {other} cannot be asked" in answers[1].sentence
        assert exit_code(one) == 7


@pytest.mark.parametrize(("changes", "said", "stays"), [
    ({"start_ns": 5}, None, False),
    ({}, "process {pid} did not answer: switch the board off", True),
    ({"host": "lab-3"}, "1 run is on host lab-3: stop it there", True),
    ({"boot": "another"}, "process {pid} on host", False),
    ({"namespace": "pid:[1]"}, "process {pid} on host", False),
    ({"pid": "12"}, "cannot be read", True),
    ({"another": 1}, "cannot be read", True),
], ids=["frozen", "copied", "host", "boot", "container", "broken", "extended"])  # fmt: skip
def test_a_file_that_no_run_holds_harms_no_process(
    folder, bystander, monkeypatch, changes, said, stays
):
    """As one that was copied, or left by a run whose process number another program has now."""
    monkeypatch.setattr(run_registry, "ANSWER_S", 0.3)
    (folder / f"{ID}.json").write_text(described(bystander.pid, changes))
    found = sentences()
    assert len(found) == (said is not None)
    if said is not None:
        assert said.format(pid=bystander.pid) in found[0]
    assert (folder / f"{ID}.json").exists() == stays


def test_a_copy_of_a_run_is_named_and_the_run_is_stopped(folder, monkeypatch):
    monkeypatch.setattr(run_registry, "ANSWER_S", 1.0)
    with in_child(until_zero(Display())) as child:
        (file,) = folder.glob("*.json")
        shutil.copy(file, folder / f"{ID}.json")
        assert sorted(answer.at_zero for answer in stop_all()) == [False, True]
        assert exit_code(child) == 7


def test_what_else_lies_in_the_folder_is_passed_over(folder):
    os.mkfifo(folder / f"{'1' * 32}.zero")
    os.mkfifo(folder / "stopped")
    (folder / "notes.txt").write_text("")
    (folder / "0.run").mkdir()
    (folder / f"{'2' * 32}.lock").symlink_to("/dev/zero")
    before = {path.name for path in folder.iterdir()}
    with Display():
        assert not stopped_since_start()
    assert stop_all() == []
    assert {path.name for path in folder.iterdir()} == before | {"lock"}


def test_a_run_that_is_frozen_or_killed_is_named(folder, monkeypatch):
    monkeypatch.setattr(run_registry, "ANSWER_S", 0.3)
    with in_child(until_zero(Display())) as child:
        os.kill(child, signal.SIGSTOP)
        assert sentences() == [f"process {child} did not answer: switch the board off"]
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        assert stop_all() == []
    assert entries(folder) == []


def test_a_run_that_withdraws_while_it_is_asked_was_closed_at_zero(folder):
    def work(say):
        with Display() as board:
            say()
            # Mostly before the run's thread has seen the request.
            until(lambda: any(folder.glob("*.stop")) or board.zeros)

    with in_child(work):
        assert [answer.at_zero for answer in stop_all()] == [True]


@pytest.mark.parametrize("how", ["files", "folder", "lock"])
def test_a_run_whose_file_is_gone_announces_itself_again(folder, how):
    with in_child(until_zero(Display())) as child:
        if how == "folder":
            shutil.rmtree(folder.parent)
            assert stop_all() == []
        else:
            for path in folder.glob("*.json" if how == "files" else "*.lock"):
                path.unlink()
        until(lambda: exit_or_files(child, folder))
        # It may find the mark of this stop, or of the earlier one, before it is asked.
        assert all(answer.at_zero for answer in stop_all())
        assert exit_code(child) == 7


def exit_or_files(child, folder):
    """Return whether both files of a run are there, or it has ended."""
    both = len(list(folder.glob("*.json"))) == len(list(folder.glob("*.lock"))) == 1
    return both or run_registry._start_ns(child) == 0


def test_a_run_that_cannot_announce_itself_again_ends_within_a_second(folder):
    with in_child(until_zero(Display())) as child:
        shutil.rmtree(folder)
        folder.write_text("a file in its place")
        begun_s = time.monotonic()
        assert exit_code(child) == 7
        assert time.monotonic() - begun_s < 3.0


def test_a_second_board_of_a_run_that_cannot_be_entered_does_not_open(folder):
    with Display(5_000):
        shutil.rmtree(folder)
        folder.write_text("a file in its place")
        with raises(SmartTouchError, names="XDG_STATE_HOME", value=folder), Display(5_000):
            pass
        folder.unlink()


def test_a_run_in_another_state_folder_is_not_claimed_to_be_stopped(folder, monkeypatch, tmp_path):
    with in_child(until_zero(Display(), 3.0)) as child:
        with monkeypatch.context() as other:
            other.setenv("XDG_STATE_HOME", str(tmp_path / "other"))
            assert stop_all() == []
        assert run_registry._start_ns(child)
        assert [answer.at_zero for answer in stop_all()] == [True]


def locks_are_not_shared(work):
    """Return work of a process on a file system that has no locks."""

    def alone(say):
        run_registry.try_lock = lambda _number, shared=False: True
        return work(say)

    return alone


def test_a_run_whose_lock_nobody_sees_is_stopped(folder):
    with in_child(locks_are_not_shared(until_zero(Display()))) as child:
        assert [answer.at_zero for answer in stop_all()] == [True]
        assert exit_code(child) == 7


PROGRAM = """
import sys, time
from tests.boards.runs import Display
with Display() as board:
    print("open", flush=True)
    while not board.zeros:
        time.sleep(0.01)
    time.sleep(0.3)
"""


@pytest.mark.parametrize("locks", [True, False])
def test_a_run_in_another_pid_namespace_is_stopped(folder, locks):
    alone = "from smarttouch.boards import run_registry as r; r.try_lock = lambda *_, **__: True;"
    code = ("" if locks else alone) + PROGRAM
    command = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc"]
    if subprocess.run([*command, "true"], check=False).returncode:
        pytest.skip("this system allows no namespaces")
    with subprocess.Popen(
        [*command, sys.executable, "-c", code], stdout=subprocess.PIPE,
        cwd=Path(__file__).parents[2],
    ) as process:  # fmt: skip
        assert process.stdout.readline() == b"open\n"
        (answer,) = stop_all()
        assert answer.at_zero
        assert "on host" in answer.sentence
        assert process.wait(20) == 0


def test_a_program_older_than_a_stop_opens_nothing_and_a_younger_one_does(folder):
    def opens(say):
        say()
        os.read(goes_on, 1)
        with pytest.raises(BoardStoppedError):
            Display().__enter__()

    goes_on, go = os.pipe()
    with in_child(opens) as child:
        stop_all()
        os.write(go, b".")
        assert exit_code(child) == 0
    with in_child(until_zero(Display(), 0.0)) as child:
        assert exit_code(child) == 98


@pytest.mark.parametrize("mark", [
    b"", b"x", b"[]", b"\xff", b'{"boot": "%(boot)s"}', b'{"boot": "%(boot)s", "time_ns": "x"}',
    b'{"boot": "another", "time_ns": %(now)d}', b'{"boot": "%(boot)s", "time_ns": %(later)d}',
])  # fmt: skip
def test_a_mark_of_another_boot_of_the_future_or_of_nothing_stops_nobody(folder, mark):
    now, boot = now_ns(), run_registry._place()[1]
    given = {b"boot": boot.encode(), b"now": now, b"later": now + 10**12}
    (folder / "stopped").write_bytes(mark % given if b"%" in mark else mark)
    assert not stopped_since_start()
    good = json.dumps({"boot": boot, "time_ns": now})
    (folder / "stopped").write_text(good)
    assert stopped_since_start()


def test_runs_are_stopped_where_no_mark_can_be_left_and_that_is_said(folder, monkeypatch):
    with in_child(until_zero(Display())) as child:
        (folder / "stopped").mkdir()
        answers = stop_all()
        assert [answer.at_zero for answer in answers] == [True, False]
        assert "stop again" in answers[1].sentence
        assert exit_code(child) == 7


def test_boards_of_all_processes_share_the_budget(folder):
    with in_child(until_zero(Display())) as child, Display():
        with raises(BoardError, names="limits.total_ma", value=20.001, allowed=20.0), Display(1):
            pass
        # A run that is gone counts nothing, however it ended.
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        with Display():
            pass


def test_of_boards_that_open_at_once_too_many_never_do(folder):
    def work(say):
        say()
        for _ in range(40):
            board = Display()
            try:
                board.__enter__()
            except BoardError:
                continue
            os.write(open_now, b"+")
            time.sleep(0.001)
            os.write(open_now, b"-")
            board.__exit__()

    looked, open_now = os.pipe()
    with ExitStack() as stack:
        for child in [stack.enter_context(in_child(work)) for _ in range(4)]:
            assert exit_code(child) == 0
    os.close(open_now)
    most = count = 0
    while signs := os.read(looked, 4096):
        for sign in signs.decode():
            count += 1 if sign == "+" else -1
            most = max(most, count)
    os.close(looked)
    assert 1 <= most <= 2
