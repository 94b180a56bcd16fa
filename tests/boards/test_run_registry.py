"""``smarttouch stop`` sets each run to zero or reports it, and leaves other processes alone."""

import json
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
import typer

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import BoardError, SmartTouchError
from smarttouch.boards import run_registry
from smarttouch.boards.run_registry import registry_folder, stop_all, stopped_since_start
from smarttouch.cli.live import stop

from ..support.checks import raises
from .emulator_waits import Display, exit_code, in_child, until, until_zero

ID = "0" * 32
AT_ZERO, UNKNOWN = "has confirmed zero", "switch the board off"


@pytest.fixture
def folder(own_state):
    registry_folder().mkdir(mode=0o700, parents=True)
    return registry_folder()


@pytest.fixture
def smarttouch_stop(capsys):
    """Return a function that runs ``smarttouch stop``: it returns exit code and sorted lines."""

    def run():
        code = 0
        try:
            stop(None)
        except typer.Exit as ended:
            code = ended.exit_code
        return code, sorted("".join(capsys.readouterr()).splitlines())

    return run


@pytest.fixture
def bystander():
    """Process that belongs to no run, and must still exist after the test."""
    with subprocess.Popen(["sleep", "60"]) as process:
        yield process
        assert process.poll() is None
        process.kill()


def entries(folder):
    return [path for path in folder.iterdir() if path.suffix]


def test_a_run_is_announced_to_its_owner_alone_as_long_as_it_lasts(own_state):
    folder = registry_folder()
    with Display(6_000), Display(4_000):
        (file,) = folder.glob("*.json")
        (lock,) = folder.glob("*.lock")
        run = json.loads(file.read_text())
        assert (run["pid"], run["current_ua"]) == (os.getpid(), 10_000)
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        for path in (file, lock):
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert entries(folder) == []


def test_what_drives_nothing_real_needs_no_folder(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with Display(announced=False):
        pass
    with raises(SmartTouchError, names="XDG_STATE_HOME", value=tmp_path / "file"), Display():
        pass


@pytest.mark.parametrize(("boards", "said"), [
    ([], []),
    ([Display()], [AT_ZERO]),
    ([Display(), Display()], [AT_ZERO, AT_ZERO]),
    ([Display(confirms=False)], [UNKNOWN]),
    ([Display(confirms=False), Display(), Display(budget_ua=0)], [UNKNOWN, AT_ZERO, AT_ZERO]),
    ([Display(confirms=False, error=ZeroDivisionError), Display()], [UNKNOWN, AT_ZERO]),
], ids=["none", "one", "two", "unconfirmed", "one unconfirmed", "one raises"])  # fmt: skip
def test_every_run_is_asked_and_says_whether_it_is_at_zero(folder, smarttouch_stop, boards, said):
    with ExitStack() as stack:
        children = [stack.enter_context(in_child(until_zero(board))) for board in boards]
        code, sentences = smarttouch_stop()
        named = dict(zip(children, said, strict=True))
        expected = sorted(f"process {child} {how}" for child, how in named.items())
        unknown = f"could not confirm zero: {UNKNOWN}"
        expected = [each.replace(UNKNOWN, unknown) + "." for each in expected]
        assert sentences == (expected or [f"No run is registered in {folder}."])
        assert code == (1 if not boards else 2 if UNKNOWN in said else 0)
        assert [exit_code(child) for child in children] == [7] * len(children)
    assert list(folder.glob("*.json")) == []


def happen(what, folder, child):
    """Disturb a run or its files; return whether the process of the run still exists."""
    file = next(folder.glob("*.json"))
    if what in ("frozen", "request withheld"):
        # Suspend the run: otherwise it could take the file made below for a stop request.
        os.kill(child, signal.SIGSTOP)
    if what == "request withheld":
        file.with_suffix(".stop").symlink_to(folder / "nowhere" / "file")
    elif what == "mark withheld":
        (folder / "stopped").mkdir()
    elif what == "copied":
        shutil.copy(file, folder / f"{ID}.json")
    elif what == "elsewhere":
        os.environ["XDG_STATE_HOME"] = str(folder / "other")
    elif what in ("killed", "defunct"):
        os.kill(child, signal.SIGKILL)
        os.waitid(os.P_PID, child, os.WEXITED | (os.WNOWAIT * (what == "defunct")))
    return what not in ("killed", "defunct")


@pytest.mark.parametrize(("what", "code", "said", "ends"), [
    ("copied", 2, [AT_ZERO, UNKNOWN], True),
    ("mark withheld", 2, [AT_ZERO, "stop again"], True),
    ("request withheld", 2, [f"cannot be asked .*: {UNKNOWN}"], False),
    ("frozen", 2, [f"did not answer: {UNKNOWN}"], False),
    ("elsewhere", 1, ["No run is registered in .*other"], False),
    ("killed", 1, ["No run is registered in "], None),
    ("defunct", 1, ["No run is registered in "], None),
])  # fmt: skip
@pytest.mark.parametrize("locks", [True, False], ids=["locks", "no locks"])
def test_what_happens_to_a_run_and_its_files_hides_it_from_no_stop(
    folder, smarttouch_stop, monkeypatch, what, code, said, ends, locks
):
    """A stop finds a run even if the file system has no locks, or does not share its locks."""
    monkeypatch.setattr(run_registry, "ANSWER_S", 1.0)
    monkeypatch.setenv("XDG_STATE_HOME", os.environ["XDG_STATE_HOME"])
    if not locks:
        monkeypatch.setattr(run_registry, "try_lock", lambda _number, shared=False: True)
    with in_child(until_zero(Display())) as child:
        alive = happen(what, folder, child)
        found, sentences = smarttouch_stop()
        assert found == code
        for pattern in said:
            assert any(re.search(pattern, each) for each in sentences), sentences
        assert len(sentences) == len(said)
        if ends:
            assert exit_code(child) == 7
        else:
            assert bool(run_registry._start_ns(child)) == alive


def described(pid, changes):
    """Return the JSON of a registry entry for this process id, with some fields changed."""
    host, boot, namespace = run_registry._place()
    fields = {"host": host, "boot": boot, "namespace": namespace, "pid": pid}
    start_ns = run_registry._start_ns(pid)
    return json.dumps(fields | {"start_ns": start_ns, "current_ua": 9_000} | changes)


@pytest.mark.parametrize(("changes", "said", "stays"), [
    ({"start_ns": 5}, None, False),
    ({}, "process {pid} did not answer: switch the board off", True),
    ({"host": "lab-3"}, "1 run is on host lab-3: stop it there", True),
    ({"boot": "another"}, "process {pid} on host", False),
    ({"namespace": "pid:[1]"}, "process {pid} on host", False),
    ({"pid": "12"}, "the run of /", False),
    ({"another": 1}, "the run of /", False),
], ids=["frozen", "copied", "host", "boot", "container", "broken", "extended"])  # fmt: skip
def test_a_file_that_no_run_holds_harms_no_process(
    folder, bystander, monkeypatch, changes, said, stays
):
    """The entry is a copy, or the process id of an ended run now belongs to another program."""
    monkeypatch.setattr(run_registry, "ANSWER_S", 0.3)
    (folder / f"{ID}.json").write_text(described(bystander.pid, changes))
    found = [answer.sentence for answer in stop_all()]
    assert len(found) == (said is not None)
    if said is not None:
        assert said.format(pid=bystander.pid) in found[0]
    assert (folder / f"{ID}.json").exists() == stays


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


def test_a_run_that_withdraws_while_it_is_asked_was_closed_at_zero(folder):
    def work(say):
        with Display() as board:
            say()
            # Usually this process sees the stop request before its registry thread does.
            until(lambda: any(folder.glob("*.stop")) or board.zeros)

    with in_child(work):
        assert [answer.at_zero for answer in stop_all()] == [True]


@pytest.mark.parametrize("what", ["*.json", "*.lock", ""])
def test_a_run_that_a_stop_would_not_find_any_more_ends_within_a_second(folder, what):
    """One of the files of the run is missing, or the whole folder."""
    with in_child(until_zero(Display())) as child:
        if what:
            next(folder.glob(what)).unlink()
        else:
            shutil.rmtree(folder.parent)
        begun_s = time.monotonic()
        assert exit_code(child) == 7
        assert time.monotonic() - begun_s < 3.0


PROGRAM = """
import sys, time
from tests.boards.emulator_waits import Display
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


@pytest.mark.parametrize("mark", [
    "", "x", "\xff", "{boot}", "{boot} x", "another {now}", "{boot} {later}",
])  # fmt: skip
def test_a_mark_of_another_boot_of_the_future_or_of_nothing_stops_nobody(folder, mark):
    now, boot = now_ns(), run_registry._place()[1]
    text = mark.format(boot=boot, now=now, later=now + 10**12)
    (folder / "stopped").write_bytes(text.encode("latin-1"))
    assert not stopped_since_start()
    (folder / "stopped").write_text(f"{boot} {now}")
    assert stopped_since_start()


def test_boards_of_all_processes_share_the_budget(folder):
    with in_child(until_zero(Display())) as child, Display():
        with raises(BoardError, names="limits.total_ma", value=20.001, allowed=20.0), Display(1):
            pass
        # The current of an ended run does not count, not even after SIGKILL.
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
