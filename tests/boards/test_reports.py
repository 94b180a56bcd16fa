"""The host's own account of what a board has scanned."""

import pytest

from smarttouch.boards.reports import HostStatistics


def test_a_range_of_scans_is_a_range_of_pulses(make_sequence):
    books = HostStatistics(8)
    sequence = make_sequence()
    books.add(sequence, 0)
    assert (books.report.sequences, books.report.pulses) == (1, 0)
    books.add(sequence, 3, again=True)
    books.add(sequence, 1, again=True, most=2)
    report = books.report
    assert (report.sequences, report.slots, report.pulses, report.most_pulses) == (1, 16, 128, 160)
    assert report.max_current_ma == pytest.approx(0.7)
    # What may have flowed counts too: four slots of .07 µC on one electrode at worst.
    exact = HostStatistics(8)
    exact.add(sequence, 4)
    assert exact.report.most_pulses == 128
    assert report.max_net_charge_uc == pytest.approx(exact.report.max_net_charge_uc + 0.28)
