"""What every driver keeps, run over each way to reach a board."""

import threading

import numpy as np
import pytest

from smarttouch.boards.emulator.books import read_delivered, read_state
from smarttouch.boards.emulator.driver import open_emulator
from smarttouch.boards.link import open_link
from smarttouch.errors import BoardError, SafetyError


class Contract:
    """Drivers subclass this with a fixture `make_board(output="weighted")`."""

    def test_it_tells_what_it_can_do(self, make_board):
        with make_board() as board:
            can = board.capabilities
            assert (can.electrodes, can.output) == (8, "weighted")
            assert can.time_to_zero_ms <= 150
            assert board.report().slots == 0

    @pytest.mark.parametrize("output", ["weighted", "three-state", "one-against-all"])
    def test_what_is_sent_is_acknowledged_and_delivered(
        self, make_board, make_sequence, books, output
    ):
        with make_board(output) as board:
            sent = []
            for step in range(5):
                sequence = make_sequence(step)
                sent.append((board.send(sequence), sequence))
                board.drain()
            report = board.report()
            assert (board.acknowledged, board.refused) == (5, 0)
        assert (report.sequences, report.slots, report.pulses) == (5, 16, 16 * 8)
        assert report.violations == 0
        assert report.max_current_ma == pytest.approx(0.7, abs=0.01)
        assert report.max_net_charge_uc < 1e-3
        numbers, _, current = read_delivered(books)
        for number, sequence in sent:
            got, planned = current[numbers == number], sequence.current_ua
            if output == "weighted":
                np.testing.assert_array_equal(got, planned)
            else:
                np.testing.assert_array_equal(np.sign(got), np.sign(planned))
                for row, source in zip(got, sequence.source_ua, strict=True):
                    assert set(row) == {source, np.rint(-source / 7)}

    def test_a_stop_from_another_thread_ends_it(self, make_board, make_sequence, books):
        with make_board() as board:
            board.send(make_sequence(0))
            board.drain()
            board.send(make_sequence(1, slots=1200, period_us=400_000))
            thread = threading.Thread(target=board.stop)
            thread.start()
            thread.join(5)
            assert not thread.is_alive()
            with pytest.raises(BoardError, match="stopped"):
                board.send(make_sequence(2))
            assert board.report().slots < 1200
        assert self.end(books) == ("shorted", "stop")

    def test_closing_puts_it_at_zero(self, make_board, make_sequence, books):
        with make_board() as board:
            board.send(make_sequence(0))
            board.drain()
            board.send(make_sequence(1, slots=1200, period_us=400_000))
        assert self.end(books) == ("shorted", "stop")
        with pytest.raises(BoardError, match="not open"):
            board.send(make_sequence(2))

    def test_an_exception_puts_it_at_zero(self, make_board, make_sequence, books):
        def run():
            with make_board() as board:
                board.send(make_sequence(0))
                board.drain()
                board.send(make_sequence(1, slots=1200, period_us=400_000))
                raise RuntimeError("something broke")

        with pytest.raises(RuntimeError, match="broke"):
            run()
        assert self.end(books) == ("shorted", "stop")

    def test_another_number_of_electrodes_is_refused(self, make_board, make_sequence):
        with make_board() as board, pytest.raises(BoardError, match="9 electrodes"):
            board.send(make_sequence(0, electrodes=9))

    def test_an_unsafe_sequence_never_leaves(self, make_board, make_sequence, monkeypatch):
        with make_board() as board:
            board.send(make_sequence(0))
            board.drain()
            written = []
            with monkeypatch.context() as patch:
                patch.setattr(board, "_send", written.append)
                with pytest.raises(SafetyError):
                    board.send(make_sequence(1, level_ua=3100))
            assert written == []
            assert board.report().violations == 0

    def test_closing_twice_is_fine(self, make_board):
        board = make_board()
        board.close()
        board.open()
        board.close()
        board.close()

    def end(self, books):
        # The process writes its books within this time of the event.
        threading.Event().wait(0.3)
        state = read_state(books)
        assert state["violations"] == 0
        return state["state"], state["reason"]


@pytest.fixture
def books(tmp_path):
    return tmp_path


class TestEmulator(Contract):
    @pytest.fixture
    def make_board(self, make_limits, books):
        return lambda output="weighted": open_emulator(
            "", make_limits(), output=output, books=books
        )


class TestLink(Contract):
    @pytest.fixture
    def make_board(self, make_limits, start_emulator, books):
        def make(output="weighted"):
            _, port = start_emulator(f"--books={books}", output=output)
            return open_link(port, make_limits(), output=output)

        return make
