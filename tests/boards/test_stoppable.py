"""Boards that a finger may be on are announced by their opening, and share one budget."""

import contextlib
import gc
import os
import resource
import signal
import stat
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from smarttouch.base.errors import BoardError, BoardStoppedError, LineLostError, SmartTouchError
from smarttouch.boards import stoppable
from smarttouch.boards.announced import running, stop_all
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.boards.open import make_board
from smarttouch.boards.reports import Capabilities
from smarttouch.profile.ceilings import CEILING_TOTAL_MA, CEILING_USER_MA
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..raising import raises
from .fresh import until

PATIENCE_S = 20
FILES = 1024  # as many as `select` knows
LIMITS = SafetyLimits(
    electrodes=4, current_ma=2.0, pulse_us=200.0, charge_uc=0.4, rate_hz=50.0, duty=0.5,
    ramp_s=1.0, full_ma=2.0,
)  # fmt: skip


class Unlined(Driver):
    """A driver without a line, whose board may have a finger on it."""

    opened = 0

    def __init__(self):
        self.zeros = []

    def open(self, line, limits):
        self.opened += 1
        self.line = line
        return Capabilities(4, "weighted", 5.0, 8, time_to_zero_ms=0.0, firmware="plain")

    def write(self, proved):
        with self.line.current(proved):
            return

    def zero(self):
        self.zeros.append(threading.get_ident())


class Lost(Unlined):
    """A driver that does not confirm zero."""

    def open(self, line, limits):
        return replace(super().open(line, limits), time_to_zero_ms=None)

    def zero(self):
        raise LineLostError("lost")


def plain(total_ma=CEILING_TOTAL_MA, kind=Unlined, limits=LIMITS):
    """Return a board without a line, which a finger may be on."""
    return Board(kind(), replace(limits, total_ma=total_ma))


@contextlib.contextmanager
def in_child(work):
    """Do something in a forked process, to whose end the block may come; yield its number."""
    ready, begun = os.pipe()
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        try:
            work(lambda: os.write(begun, b"."))
            os._exit(0)
        finally:
            os._exit(1)
    os.close(begun)
    assert os.read(ready, 1) == b"."
    os.close(ready)
    try:
        yield child
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(child, 0)


def waiting(*boards):
    """Return what opens boards, says so, and waits."""

    def work(say):
        for board in boards:
            board.open()
        say()
        signal.pause()

    return work


def test_a_board_is_announced_while_it_is_open():
    with plain():
        assert running() == [os.getpid()]
        with plain(5.0):
            assert running() == [os.getpid()]
        assert running() == [os.getpid()]
    assert running() == []


@pytest.mark.parametrize("url", ["memory:", "simulated:"])
def test_one_that_no_finger_can_be_on_is_not(url, profile):
    limits = SafetyLimits.of(profile)
    with make_board(url, limits, profile.output):
        assert running() == []


def test_a_board_that_its_program_has_forgotten_is_counted_and_stopped():
    """A driver without a thread, whose board goes on: nothing else refers to it."""

    def work(say):
        def zero(_):
            os.write(stopped, b".")

        Unlined.zero = zero
        plain().open()
        gc.collect()
        assert sum(stoppable._program._boards.values()) == 1000 * CEILING_TOTAL_MA
        say()
        time.sleep(PATIENCE_S)

    told, stopped = os.pipe()
    with in_child(work):
        assert stop_all() == 1
        os.close(stopped)
        assert os.read(told, 1) == b"."
    os.close(told)


@pytest.mark.parametrize("fails", ["open", "stopped"])
def test_one_that_does_not_open_is_not(monkeypatch, fails):
    board = plain()
    if fails == "open":
        monkeypatch.setattr(Unlined, "open", lambda *_: 1 / 0)
    else:
        board.halt()
    with pytest.raises(ZeroDivisionError if fails == "open" else BoardStoppedError):
        board.open()
    assert running() == []


def test_the_folder_and_its_files_are_for_their_owner_alone(own_state):
    with plain():
        (folder,) = Path(os.environ["XDG_STATE_HOME"]).iterdir()
        files = {each.suffix: stat.S_IMODE(each.stat().st_mode) for each in folder.iterdir()}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert files == {".run": 0o600, ".stop": 0o600}
    assert list(folder.iterdir()) == []


def too_much(total_ma):
    return raises(BoardError, names="limits.total_ma", value=total_ma, allowed=CEILING_USER_MA)


@pytest.mark.parametrize("total_ma", [10.0, 5.0, 0.001])
def test_boards_of_a_process_share_the_budget(total_ma):
    with contextlib.ExitStack() as stack:
        for _ in range(min(8, round(CEILING_USER_MA / total_ma))):
            stack.enter_context(plain(total_ma))
        one_more = plain(10.0)
        if total_ma < 1:
            stack.enter_context(one_more)
            return
        with too_much(CEILING_USER_MA + 10.0):
            one_more.open()
        assert one_more.driver.opened == 0
    with one_more:
        assert one_more.driver.opened == 1


def test_boards_of_all_processes_share_the_budget():
    with in_child(waiting(plain())) as child, plain():
        with too_much(CEILING_USER_MA + 0.001):
            plain(0.001).open()
        # One that is gone counts nothing, however it ended.
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        with plain():
            pass


def test_of_boards_that_open_at_once_too_many_never_do():
    def work(say):
        say()
        for _ in range(40):
            with contextlib.suppress(BoardError), plain():
                # Looked at while it is open: what is declared is never above the ceiling, but for
                # what others declare that will be refused.
                os.write(open_now, b"+")
                time.sleep(0.001)
                os.write(open_now, b"-")

    looked, open_now = os.pipe()
    with contextlib.ExitStack() as stack:
        for child in [stack.enter_context(in_child(work)) for _ in range(4)]:
            os.waitpid(child, 0)
    os.close(open_now)
    most = count = 0
    while signs := os.read(looked, 4096):
        for sign in signs.decode():
            count += 1 if sign == "+" else -1
            most = max(most, count)
    os.close(looked)
    assert 1 <= most <= 2


def test_stopping_a_board_that_confirms_no_zero_is_an_error():
    def work(say):
        with plain(kind=Lost):
            say()
            time.sleep(PATIENCE_S)

    late = {}
    with in_child(work) as child, raises(SmartTouchError, **late, value=(child,)):
        stop_all()


def test_a_program_with_many_open_files_is_stopped():
    def work(say):
        _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
        files = [os.open("/dev/null", os.O_RDONLY) for _ in range(FILES)]
        with plain() as board:
            say()
            until(lambda: board._halted)
        for each in files:
            os.close(each)

    with in_child(work) as child:
        assert stop_all() == 1
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_that_it_has_not_is_told_also_where_its_program_closes_it_and_ends():
    def work(say):
        board = plain(kind=Lost)
        board.open()
        say()
        until(lambda: board._halted)
        with pytest.raises(LineLostError):
            board.close()

    unconfirmed = {}
    with in_child(work) as child, raises(SmartTouchError, **unconfirmed, value=(child,)):
        stop_all()


def test_a_stop_is_for_good_in_a_process_that_goes_on():
    def work(say):
        board = plain()
        board.open()
        say()
        until(lambda: board._halted)
        until(lambda: not running())
        for each in (board, plain()):
            board.close()
            with pytest.raises(BoardStoppedError):
                each.open()

    with in_child(work) as child:
        assert stop_all() == 1
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_a_forked_process_does_not_drive_the_boards_of_its_parent():
    with plain() as board:
        with in_child(lambda say: say() if board._stopped.is_set() else None) as child:
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert running() == [os.getpid()]
        assert not board._stopped.is_set()


def test_a_forked_process_that_closes_the_boards_of_its_parent_writes_nothing(monkeypatch):
    told, writes = os.pipe()
    monkeypatch.setattr(Unlined, "zero", lambda _: os.write(writes, b"."))
    with plain() as board:
        with in_child(lambda say: (board.close(), say())) as child:
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        os.set_blocking(told, False)
        with pytest.raises(BlockingIOError):
            os.read(told, 1)
    os.close(told)
    os.close(writes)


def test_handlers_of_signals_are_there_while_a_board_is_open():
    def work(say):
        default = [signal.SIG_DFL] * 2
        numbers = (signal.SIGTERM, signal.SIGHUP)
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)
        for _ in range(2):
            with plain():
                assert [signal.getsignal(each) for each in numbers] != default
            assert [signal.getsignal(each) for each in numbers] == default
        assert signal.set_wakeup_fd(-1) == -1
        say()

    with in_child(work) as child:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_they_are_there_for_the_main_thread_also_where_another_has_one_open():
    def work(say):
        opening = threading.Thread(target=plain().open)
        opening.start()
        opening.join()
        with plain() as board:
            _sleep(say, board)

    assert _code_at_sigterm(work) == 128 + signal.SIGTERM


@pytest.mark.parametrize("loop_starts", [None, "before", "after"])
def test_a_signal_ends_a_process_whatever_its_event_loop_does(loop_starts):
    def start_loop():
        _, own = os.pipe()
        os.set_blocking(own, False)
        signal.set_wakeup_fd(own)

    def work(say):
        if loop_starts == "before":
            start_loop()
        with plain() as board:
            if loop_starts == "after":
                start_loop()
            _sleep(say, board)

    assert _code_at_sigterm(work) == 128 + signal.SIGTERM


def _sleep(say, board):
    """Say that a board is open, and sleep; however that ends, wait for the board's end."""
    say()
    try:
        time.sleep(PATIENCE_S)
    finally:
        until(lambda: board._halted)


def _code_at_sigterm(work):
    """Return the exit code of a forked process that gets SIGTERM while it works."""
    with in_child(_ending(work)) as child:
        os.kill(child, signal.SIGTERM)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _ending(work):
    """Return work whose SystemExit ends the process as the interpreter would."""

    def ends(say):
        try:
            work(say)
        except SystemExit as ended:
            os._exit(ended.code)

    return ends
