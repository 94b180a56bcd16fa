"""All boards of a process share one registry entry. A signal sets all these boards to zero."""

import hashlib
import os
import signal
import threading
import time

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.base.stopping import RunStopped, StopRequest, uninterrupted
from smarttouch.boards.open import make_board
from smarttouch.boards.run_registry import registry_folder, stop_all, stopped_since_start
from smarttouch.boards.shutdown import enter, expect, running_command, stoppable_run
from smarttouch.profile.project_ceilings import CEILING_USER_MA
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.checks import raises
from .emulator_waits import PATIENCE_S, Display, exit_code, in_child, until

MOST_UA = round(1000 * CEILING_USER_MA)


@pytest.fixture(autouse=True)
def folder(own_state):
    return registry_folder()


def runs(folder):
    return len(list(folder.glob("*.json")))


def test_boards_of_a_process_share_the_budget(folder):
    with Display(MOST_UA // 2), Display(MOST_UA // 2):
        allowed = {"value": CEILING_USER_MA + 0.001, "allowed": CEILING_USER_MA}
        with raises(BoardError, names="limits.total_ma", **allowed), Display(1):
            pass
        with Display(0):
            pass
    with Display(MOST_UA):
        pass


def test_that_zero_was_not_confirmed_is_said_also_where_the_program_closes_its_board():
    def work(say):
        with Display(confirms=False) as board:
            say()
            until(lambda: board.zeros)

    with in_child(work):
        (answer,) = stop_all()
    assert not answer.at_zero
    assert "switch the board off" in answer.sentence


def test_a_run_is_asked_to_end_before_its_board_is_at_zero():
    stop, order = StopRequest(), []

    def work(say):
        # Functions called on a stop may be slow. They must not delay zero.
        stop.always_on_stop(lambda: time.sleep(PATIENCE_S))
        board = Display()
        board.zero = lambda how: order.append(stop.event.is_set())
        with stoppable_run(stop, board), board:
            say()
            assert stop.event.wait(PATIENCE_S)
            until(lambda: order)
        assert (stop.reason, order) == ("smarttouch stop", [True])

    with in_child(work) as child:
        assert [answer.at_zero for answer in stop_all()] == [True]
        assert exit_code(child) == 0


def test_a_run_is_announced_as_long_as_it_lasts(folder):
    with stoppable_run(StopRequest(), Display()):
        assert runs(folder) == 1
    assert runs(folder) == 0


class TestForks:
    """A forked process has its own boards, registry entry and signal handlers."""

    def test_it_cannot_use_the_boards_of_its_parent(self, profile):
        def work(say):
            for act in (board.stop, board.halt, board.close, board.measure, board.open):
                with pytest.raises(BoardError):
                    act()
            say()

        with make_board("memory:", SafetyLimits.of(profile), profile.output) as board:
            with in_child(work) as child:
                assert exit_code(child) == 0
            assert not board._stopped.is_set()

    def test_its_end_and_its_signals_leave_the_parent_alone(self, folder):
        def work(say):
            assert signal.set_wakeup_fd(-1) == -1
            say()
            signal.pause()

        with Display() as board:
            with in_child(work) as child:
                os.kill(child, signal.SIGTERM)
                assert exit_code(child) == -signal.SIGTERM
            time.sleep(0.1)
            assert (board.zeros, runs(folder)) == ([], 1)

    def test_it_is_announced_by_itself(self, folder):
        def work(say):
            with Display(5_000):
                assert runs(folder) == 2
                say()

        with Display(), in_child(work) as child:
            assert exit_code(child) == 0
            assert runs(folder) == 1

    def test_it_does_not_keep_the_lock_of_a_parent_that_has_ended(self, folder):
        def parent(say):
            Display().__enter__()
            if os.fork() == 0:
                time.sleep(3.0)
                os._exit(0)
            say()
            os._exit(0)

        with in_child(parent) as child:
            exit_code(child)
            assert stop_all() == []


def handlers():
    return [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]


def test_handlers_are_there_while_a_board_is_open_and_leave_nothing_behind():
    def work(say):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        before, threads = handlers(), threading.active_count()
        for _ in range(2):
            with Display():
                now = handlers()
                assert now[2] == signal.SIG_IGN
                assert now[0] == now[1] != before[1]
            assert handlers() == before
            until(lambda: threading.active_count() == threads)
        assert signal.set_wakeup_fd(-1) == -1
        say()

    with in_child(work) as child:
        assert exit_code(child) == 0


def start_event_loop():
    """Replace the wakeup file descriptor for signals, as asyncio does."""
    _, own = os.pipe()
    os.set_blocking(own, False)
    signal.set_wakeup_fd(own)


def sleeping(before=lambda: None, within=lambda: None, opening=lambda board: board.__enter__()):
    """Return a function that opens a board, sleeps until a signal, and then waits for zero."""

    def work(say):
        board = Display()
        before()
        opening(board)
        try:
            # If another thread opened the first board, opening this board installs the handlers.
            with Display(1):
                within()
                say()
                time.sleep(PATIENCE_S)
        finally:
            until(lambda: board.zeros)

    return work


def in_a_thread(board):
    thread = threading.Thread(target=board.__enter__)
    thread.start()
    thread.join()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("options", [
    {}, {"before": start_event_loop}, {"within": start_event_loop}, {"opening": in_a_thread},
], ids=["plain", "loop before", "loop after", "another thread"])  # fmt: skip
def test_a_signal_ends_a_program_with_its_boards_at_zero(number, options):
    with in_child(sleeping(**options)) as child:
        os.kill(child, number)
        assert exit_code(child) == 128 + number


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_boards_are_at_zero_while_the_main_thread_cannot_run_a_handler(number):
    def work(say):
        with Display() as board:
            board.zero = lambda how: os._exit(42)
            say()
            # This call takes many seconds, and Python runs no signal handler meanwhile.
            hashlib.pbkdf2_hmac("sha256", b"", b"", 200_000_000)

    with in_child(work) as child:
        time.sleep(0.2)
        os.kill(child, number)
        assert exit_code(child) == 42


def test_ctrl_c_in_a_program_lets_it_go_on_and_open_another_board():
    def work(say):
        say()
        for _ in range(3):
            with Display(1) as board:
                with pytest.raises(KeyboardInterrupt):
                    signal.raise_signal(signal.SIGINT)
                until(lambda: board.zeros == ["stop"])

    with in_child(work) as child:
        assert exit_code(child) == 0


def test_a_program_that_was_told_to_end_opens_no_other_board():
    def end(board):
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            until(lambda: board.zeros)

    def work(say):
        with pytest.raises(RunStopped), Display(1) as board:
            end(board)
        with raises(BoardError, names="SIGTERM"), Display(1):
            pass
        say()

    with in_child(work) as child:
        assert exit_code(child) == 0


def test_a_signal_that_a_program_handles_itself_stops_no_board():
    def work(say):
        signal.signal(signal.SIGTERM, lambda *_: None)
        with Display(1) as board:
            signal.raise_signal(signal.SIGTERM)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            until(lambda: board.zeros)
            assert board.zeros == ["stop"], "only Ctrl-C may stop the board"
        say()

    with in_child(work) as child:
        assert exit_code(child) == 0


def test_no_exception_is_raised_within_a_write():
    written = []

    def write():
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            with uninterrupted():
                written.append("first")
            written.append("second")
        written.append("after it")

    with Display(), pytest.raises(KeyboardInterrupt):
        write()
    assert written == ["first", "second"]


class TestCommands:
    """Signals and stop requests end a command, also before it has opened a board."""

    @pytest.mark.parametrize(("number", "name"), [
        (signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP"),
    ])  # fmt: skip
    def test_a_signal_interrupts_once_where_nothing_ends_in_order(self, number, name):
        def work(say):
            say()
            with running_command(os._exit) as command:
                try:
                    os.kill(os.getpid(), number)
                    time.sleep(PATIENCE_S)
                except RunStopped:
                    assert command.stop.event.wait(PATIENCE_S)
                    os._exit(40 + number if command.stop.reason == name else 98)

        with in_child(work) as child:
            assert exit_code(child) == 40 + number

    def test_what_does_not_end_in_order_is_given_up(self):
        """`give_up` is called after ``patience_s``, but never before the boards are at zero."""

        def work(say):
            def give_up(number):
                os._exit(42 if zeros else 98)

            zeros = []
            with running_command(give_up) as command:
                board = Display(zeros=zeros)
                board.zero = lambda how: (time.sleep(0.3), zeros.append(how))
                with board:
                    command.orderly = True
                    command.patience_s = 0.1
                    say()
                    while True:
                        time.sleep(0.01)

        with in_child(work) as child:
            os.kill(child, signal.SIGTERM)
            assert exit_code(child) == 42

    def test_one_that_will_open_a_board_is_announced_and_stopped_before_it_does(self, folder):
        def work(say):
            with running_command(os._exit):
                assert runs(folder) == 0
                expect(Display(announced=False))
                assert runs(folder) == 0
                expect(Display())
                assert runs(folder) == 1
                say()
                time.sleep(PATIENCE_S)

        with in_child(work) as child:
            assert [answer.at_zero for answer in stop_all()] == [True]
            assert exit_code(child) == 128 + signal.SIGTERM
        assert runs(folder) == 0

    def test_one_that_finds_others_stopped_says_by_what(self):
        def work(say):
            def open_late():
                say()
                until(stopped_since_start)
                enter(Display())

            with pytest.raises(RunStopped, match="smarttouch stop"), running_command(os._exit):
                open_late()

        with in_child(work) as child:
            stop_all()
            assert exit_code(child) == 0
