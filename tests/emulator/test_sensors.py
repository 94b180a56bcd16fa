"""Emulated sensors: what they send."""

import math

import numpy as np
import pytest

from smarttouch.emulator.sensors import LoadCell, SensorArray, look_at_page, look_at_pattern, press
from smarttouch.errors import SourceError
from smarttouch.sources.forces.readings import TextReadings
from smarttouch.sources.sensor_protocol import ArrayFrame, CellReading, Info, MessageStream

from ..raising import raises


def packet(device, number, time_s, *wrong):
    device.wrong = frozenset(wrong)
    return device.packet(number, time_s)


def test_an_array_sends_frames_and_once_a_second_its_name():
    device = SensorArray(look_at_pattern(6, 9), rate_hz=4)
    stream, messages = MessageStream(), []
    for number in range(5):
        messages += stream.feed(packet(device, number, number / 4))
    frames = [each for each in messages if isinstance(each, ArrayFrame)]
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_us for frame in frames] == [0, 250_000, 500_000, 750_000, 1_000_000]
    assert frames[0].image.shape == (6, 9)
    assert sum(isinstance(each, Info) for each in messages) == 2
    # 40 pixels a second from right to left.
    first, later = frames[0].image, look_at_pattern(6, 9)(3 / 40)
    np.testing.assert_array_equal(first[:, 3:], later[:, :-3])


def test_an_array_that_freezes():
    device = SensorArray(look_at_pattern(8, 8), rate_hz=100)
    stream = MessageStream()
    (_, before) = stream.feed(packet(device, 0, 0))
    (frozen,) = stream.feed(packet(device, 1, 10, "freeze"))
    (after,) = stream.feed(packet(device, 2, 10))
    np.testing.assert_array_equal(before.image, frozen.image)
    assert (after.image != frozen.image).any()


def test_an_array_reads_a_page_again_and_again(profile):
    look = look_at_page("text:o", profile, 16, 24)
    assert look(0.0).shape == look(1000.0).shape == (16, 24)
    assert max(np.ptp(look(time_s)) for time_s in np.arange(0, 3, 0.02)) > 100
    allowed = ("page", "text")
    with raises(SourceError, about="url", value="camera:0", allowed=allowed):
        look_at_page("camera:0", profile, 16, 16)


@pytest.mark.parametrize("framed", [False, True])
def test_a_cell_follows_its_line(profile, tmp_path, framed):
    record = tmp_path / "force.csv"
    record.write_text("time_s,force_n\n0,0\n1,2\n")
    force = press(9.0, record, profile)
    device = LoadCell(force, counts_per_n=1000, zero=-200, noise=0, framed=framed)

    def at(time_s, *wrong):
        data = packet(device, 0, time_s, *wrong)
        if framed:
            (message,) = MessageStream().feed(data)
            assert isinstance(message, CellReading)
            return message.reading
        (reading,) = TextReadings().feed(b"\n" + data)
        return None if math.isnan(reading) else reading

    assert [at(0.5), at(1), at(9)] == [800, 1800, -200]
    assert at(0.5, "freeze") == -200
    assert at(0.5, "nan") is None
    device.take_order(["force", "1e9"])
    assert at(0) == 2**23 - 1


def test_a_cells_noise():
    device = LoadCell(press(1.0, None, None), 1000, 0, noise=50, framed=True)
    stream = MessageStream()
    readings = [stream.feed(packet(device, 0, 0))[0].reading for _ in range(2000)]
    assert np.mean(readings) == pytest.approx(1000, abs=5)
    assert np.std(readings) == pytest.approx(50, rel=0.1)
