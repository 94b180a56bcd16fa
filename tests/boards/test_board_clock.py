"""When sequences began, by the board's clock and the host's."""

from hypothesis import given
from hypothesis import strategies as st

from smarttouch.boards.link.packet_line import BoardClock

MS = 1_000_000


@given(
    st.lists(
        st.tuples(st.integers(0, 30), st.integers(0, 20), st.sampled_from([0, 0, 0, 50])),
        min_size=1,
    ),
    st.integers(0, 10**6),
)
def test_no_sequence_begins_before_it_was_sent_or_after_its_answer(sequences, first_us):
    clock, sent_ns, behind_us = BoardClock(), 10**9, 0
    for waits_ms, answers_ms, stands_still_ms in sequences:
        behind_us += 1000 * stands_still_ms
        sent_ns += stands_still_ms * MS
        began_ns = sent_ns + waits_ms * MS
        board_us = began_ns // 1000 + first_us - behind_us
        time_ns = clock.note(board_us, sent_ns, began_ns + answers_ms * MS)
        assert sent_ns <= time_ns <= began_ns + answers_ms * MS
        sent_ns = began_ns + 20 * MS
