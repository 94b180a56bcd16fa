"""Contract tests of the journal driver, and tests of its file."""

import re
from pathlib import Path

import pytest
from smarttouch_journal import JournalDriver

import smarttouch as st
from smarttouch.testing import ZERO, DriverContract, SentPulse


class TestJournal(DriverContract):
    @pytest.fixture(autouse=True)
    def _file(self, tmp_path: Path) -> None:
        self.path = tmp_path / "run.txt"

    def make(self, limits: st.SafetyLimits) -> st.Driver:
        return JournalDriver(str(self.path), limits)

    def received(self) -> bytes:
        return self.path.read_bytes()

    def decode(self, data: bytes) -> list[SentPulse]:
        """Return the pulses of a journal. The pulses of a scan are repeated for each pass."""
        found: list[SentPulse] = []
        for part in re.split(r"^(?=zero|scan)", data.decode(), flags=re.MULTILINE)[1:]:
            head, *slots = part.splitlines()
            if head == "zero":
                found.append(ZERO)
                continue
            times, period_us = map(int, re.findall(r"\d+", head))
            for _ in range(times):
                for slot in slots:
                    width_us, discharge_us, *flows = map(int, re.findall(r"[-+]?\d+", slot))
                    found.append(SentPulse(tuple(flows), width_us, discharge_us, period_us))
        return found

    def test_each_slot_is_a_line(self, new_board) -> None:
        with new_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1), times=3)
        zero, first, second, *slots, end = self.path.read_text("utf-8").splitlines()
        assert (zero, first, end) == ("zero", "scan: 1 x 10000 us", "zero")
        assert second == "scan: 3 x 10000 us"
        pulse = "  100 us, then 50 us shorted: +315, -45, -45, -45, -45, -45, -45, -45 uA"
        assert slots[0] == pulse
        assert len(slots) == 4


@pytest.mark.parametrize("rest", ["", "no/such/folder/run.txt"])
def test_files_that_cannot_be(rest: str) -> None:
    limits = st.SafetyLimits(8, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)
    with pytest.raises(st.BoardError, match="file"):
        st.Board(JournalDriver(rest, limits), limits).open()
