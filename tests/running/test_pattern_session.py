"""Tests of sessions: patterns have the requested level, and the board is at zero at the end."""

import asyncio
import contextlib
import itertools
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import BoardError, SmartTouchError
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.running.replay_check import assert_replays
from smarttouch.running.step_records import OnEvent, OnStep

from ..support.checks import raises
from ..support.full import WHOLE, sample
from ..support.runs import undisturbed, until

RING = np.zeros(64, np.float32)
RING[[18, 19, 20, 26, 28, 34, 35, 36]] = 1
LETTER = st.open_source("text:AAAAA", st.load_profile("electric-mouse")).read(9 * 10**8).image
EMULATOR = pytest.param("emulator:", marks=pytest.mark.realtime)
URLS = sample([EMULATOR, "memory:", "simulated:"])


def session(url="memory:", profile="electric-mouse", mode="RA", intensity=0.6, **given):
    results = []
    display = st.open_display(url, profile)
    touch = display.session(
        mode=mode, intensity=intensity, listeners=[results.append, *given.pop("listeners", ())],
        **given,
    )  # fmt: skip
    return touch, results


def shown_by(results, began_ns, seconds):
    return [each for each in results if began_ns <= each.input.time_ns < began_ns + seconds * 10**9]


@pytest.mark.parametrize("url", URLS)
def test_after_a_rise_a_pattern_is_at_its_level_from_its_first_pulse(url):
    def attempt():
        touch, results = session(url)
        rises, found = [], []
        with touch, contextlib.suppress(st.LevelNotReachedError):
            rises += [touch.rise() for _ in range(2)]
            found += [touch.show(RING, 0.5) for _ in range(2)]
        assert touch.statistics.ended == "the session is over"
        return touch.statistics, results, rises, found

    results, rises, found = undisturbed(attempt)
    assert rises[0] > rises[1] == 0
    for shown in found:
        assert (shown.sequences, shown.intensity, shown.ramped_s) == (25, 0.6, 0)
        own = shown_by(results, shown.time_ns, 0.5)
        assert len(own) == 25
        for each in own:
            assert each.sequence.intensity == 0.6
            np.testing.assert_array_equal(each.tactile.activation[st.Afferent.RA], RING)
        assert shown.pulses == sum(each.sequence.slots for each in own)
    assert found[0].clock_ns < found[1].clock_ns <= time.monotonic_ns()
    began_us = [each.board_us for each in found]
    if url == "memory:":
        assert began_us == [None, None]
    else:
        assert began_us[1] - began_us[0] >= 0.5e6


def test_a_level_that_is_not_open_is_opened_first_with_an_event():
    events = []
    touch, results = session(listeners=[OnEvent(events.append)])
    with touch:
        shown = touch.show(RING, 0.1)
    assert shown.ramped_s > 0.2
    assert (shown.sequences, shown.intensity) == (5, 0.6)
    weak = [each for each in results if each.input.time_ns < shown.time_ns and each.sequence.slots]
    # While intensity rises, only the pattern's sites are stimulated, with currents near threshold.
    assert 0 < max(abs(each.sequence.current_ua).max() for each in weak) < 0.6 * 1.3 * 1200
    assert all((each.tactile.activation[:, RING == 0] == 0).all() for each in weak)
    assert [str(each) for each in events if "waited" in str(each)]


@pytest.mark.parametrize(("mode", "pattern", "level"), sample([
    ("SAI", RING > 0, 1.0),
    ("natural", np.stack([RING, RING, 0 * RING]), 1.0),
    ("COLOR", np.stack([RING, 0 * RING, RING]), 1.0),
    ("RA", LETTER, 0.5),
    ("natural", st.Frame(LETTER, 0), 0.3),
    ("RA", st.TactileImage(np.stack([RING, 0 * RING, 0 * RING]), 0, 0.9), 1.0),
]))  # fmt: skip
def test_patterns_of_every_kind_are_at_the_level_asked(mode, pattern, level):
    touch, results = session("simulated:", mode=mode)
    with touch:
        shown = touch.show(pattern, 0.2, level)
    assert shown.pulses > 0
    assert shown.intensity == pytest.approx(0.6 * level)
    own = shown_by(results, shown.time_ns, 0.2)
    assert all(each.sequence.intensity == pytest.approx(0.6 * level) for each in own)
    if mode == "natural" and level < 1:
        np.testing.assert_array_equal(own[0].input.image, LETTER)


def test_what_cannot_be_shown_is_refused_and_the_session_goes_on():
    touch, _ = session()
    with touch:
        for pattern in (
            RING[:5], np.full(64, np.nan), 2 * RING, "RING", np.zeros((2, 3, 4), np.uint8),
        ):  # fmt: skip
            with pytest.raises(SmartTouchError):
                touch.show(pattern, 0.1)
        for names, call in (
            ("seconds", lambda: touch.show(RING, 0)),
            ("level", lambda: touch.show(RING, 0.1, level=1.1)),
            ("level", lambda: touch.rise(0)),
            ("mode", lambda: touch.controls.choose_mode("XYZ")),
        ):
            with raises(SmartTouchError, names=names):
                call()
            assert touch.show(RING, 0.1).sequences == 5


def test_without_force_no_level_is_reached():
    touch, results = session(force="fixed:0")
    touch.patience_s = 0.3
    with touch, raises(st.LevelNotReachedError, names="level"):
        touch.show(RING, 0.1)
    assert not any(each.sequence.slots for each in results)


def test_a_pause_within_a_pattern_is_an_error_and_not_a_weak_pattern():
    touch, _ = session()
    with touch:
        touch.rise()
        threading.Timer(0.2, touch.controls.pause).start()
        with raises(st.LevelNotReachedError):
            touch.show(RING, 5.0)
        touch.controls.resume()
        assert touch.show(RING, 0.1).intensity == 0.6
        touch.controls.set_level(0.3)
        touch.controls.choose_mode("SAI")
        assert (touch.controls.state(0).level, touch.mode) == (0.3, "SAI")
        assert touch.show(RING, 0.1).intensity == 0.3


@pytest.mark.parametrize("url", sample([EMULATOR, "memory:"]))
def test_the_newest_pattern_wins_and_a_stale_one_is_zero(url):
    other = np.roll(RING, 1)

    def attempt():
        touch, results = session(url)
        with touch:
            touch.rise()
            for pattern in (RING, other) * 10:
                touch.put(pattern, stale_s=0.3)
                time.sleep(0.02)
            until(lambda: any(each.input.stale for each in results))
            time.sleep(0.1)
        return touch.statistics, results

    (results,) = undisturbed(attempt)
    put = [each for each in results if each.tactile.activation[st.Afferent.RA].max() == 1]
    for before, after in itertools.pairwise(put):
        assert before.input.number <= after.input.number
    numbers = {each.input.number for each in put}
    np.testing.assert_array_equal(put[-1].tactile.activation[st.Afferent.RA], other)
    assert max(numbers) - min(numbers) <= 19
    assert all(each.sequence.intensity == 0.6 for each in put)
    # After the pattern became stale, no sequence has slots.
    end_ns = put[-1].input.time_ns
    after = [each.sequence.slots for each in results if each.input.time_ns > end_ns]
    assert set(after) == {0}


def in_a_loop(coroutine):
    """Run a coroutine in a new thread: Playwright's event loop may occupy the main thread."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, coroutine).result()


@pytest.mark.realtime
@pytest.mark.parametrize("url", ["memory:", "simulated:"])
def test_the_displays_of_a_hand_begin_together(url):
    profiles = sample(["electric-mouse", "electric-mouse", "smarttouch-4x4", "electric-mouse"])
    pulsed_ns = [[] for _ in profiles]
    notes = [
        OnStep(lambda each, own=own: each.sequence.slots and own.append(time.monotonic_ns()))
        for own in pulsed_ns
    ]
    hand = [session(url, profile=each, listeners=[note])[0]
            for each, note in zip(profiles, notes, strict=True)]  # fmt: skip
    with contextlib.ExitStack() as stack:
        for each in hand:
            stack.enter_context(each)
        patterns = {each: RING[: len(each._display.profile.electrodes)] for each in hand}
        shown = st.show_together(patterns, 0.2)
        hand[1].patience_s = 0.3
        with raises(st.LevelNotReachedError, names="level"):
            hand[1].controls.pause()
            st.show_together(patterns, 0.2)
    assert {each.sequences for each in shown.values()} == {10}
    assert {each.ramped_s for each in shown.values()} == {0}
    # The ramps of the displays overlap: each ramp begins before any other ramp ends.
    if url == "memory:":
        began_ns = [at.clock_ns for at in shown.values()]
        # A busy computer may delay a display by some periods of 20 ms. A ramp takes 500 ms.
        assert max(began_ns) - min(began_ns) < 100_000_000
        rising = [
            [each for each in own if each < at.clock_ns]
            for own, at in zip(pulsed_ns, shown.values(), strict=True)
        ]
        assert max(own[0] for own in rising) < min(own[-1] for own in rising)


@pytest.mark.parametrize("url", ["memory:", "simulated:"])
def test_a_level_may_be_a_function_of_time_that_also_ends_its_pattern(url):
    touch, results = session(url, intensity=1.0)
    times = []

    def level(since_s):
        times.append(since_s)
        return 0.1 + since_s if since_s < 0.15 else None

    with touch:
        touch.rise()
        shown = touch.show(RING, 1.0, level, rate_hz=25)
        touch.wait(0.1)
        touch.show(RING, 0.1)
    own = shown_by(results, shown.time_ns, 0.15)
    assert [each.sequence.period_us for each in own] == [40_000] * 4
    assert [each.sequence.intensity for each in own] == pytest.approx([0.1, 0.14, 0.18, 0.22])
    assert shown.current_ma == pytest.approx(abs(own[-1].sequence.current_ua).max() / 1000)
    assert shown.sequences == 4
    if url == "simulated:":
        after = [each for each in results if each.input.time_ns >= shown.time_ns + 160_000_000]
        silent = [each for each in after if not each.sequence.slots]
        assert sum(each.sequence.period_us for each in silent) == 100_000


def test_a_task_that_is_canceled_ends_its_pattern():
    touch, results = session()

    async def main():
        await touch.show_async(RING, 0.1)
        showing, before = asyncio.create_task(touch.show_async(RING, 30.0)), len(results)
        while len(results) == before:
            await asyncio.sleep(0.01)
        waiting = asyncio.create_task(touch.show_async(np.roll(RING, 1), 30.0))
        await asyncio.sleep(0.2)
        for each in (waiting, showing):
            each.cancel()
            with pytest.raises(asyncio.CancelledError):
                await each
        return await touch.show_async(RING, 0.1)

    with touch:
        assert in_a_loop(main()).sequences == 5
    rolled = [each for each in results if each.tactile.activation[0, 21] > 0.5]
    assert rolled == []


@pytest.mark.parametrize("call", ["show", "wait"])
def test_what_interrupts_a_call_ends_what_it_shows(call):
    """After Ctrl-C in a notebook, the session can continue."""
    touch, results = session()
    main = threading.main_thread().ident
    with touch:
        threading.Timer(1.0, signal.pthread_kill, (main, signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            touch.show(RING, 30.0) if call == "show" else touch.wait(30.0)
        assert touch.show(RING, 0.1).sequences == 5
    full = [each for each in results if each.tactile.activation.max() == 1]
    assert len(full) < 100


@pytest.mark.parametrize("when", ["prepare", "start", "step", "finish"])
def test_a_listener_that_fails_ends_the_session_with_its_own_error(when):
    class Fails(st.Listener):
        def fail(self, _):
            raise ZeroDivisionError(when)

    setattr(Fails, when, Fails.fail)
    touch, _ = session("simulated:", listeners=[Fails()])
    with pytest.raises(ZeroDivisionError), touch:
        touch.show(RING, 30.0 if when == "step" else 0.1)
    assert "closed" in repr(touch)


def test_what_ends_the_block_ends_at_zero_and_nothing_is_shown_outside_it():
    touch, _ = session("emulator:")
    with raises(SmartTouchError, names="session"):
        touch.show(RING, 0.1)

    def fails():
        with touch:
            touch.rise()
            touch.put(RING, stale_s=60)
            time.sleep(0.1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    assert "ZeroDivisionError" in touch.statistics.ended
    assert touch.statistics.figures["emulator_violations"] == 0
    assert "closed" in repr(touch)
    for call in (
        lambda: touch.show(RING, 0.1), lambda: touch.put(RING), touch.rise, touch.__enter__,
    ):  # fmt: skip
        with raises(SmartTouchError, names="session"):
            call()


@pytest.mark.parametrize("ending", ["session", "display"])
def test_a_stop_meanwhile_ends_what_waits(ending):
    touch, results = session("emulator:")
    with touch:
        touch.rise()
        threading.Timer(0.3, touch.stop if ending == "session" else touch._display.stop).start()
        with pytest.raises((st.LevelNotReachedError, SmartTouchError)):
            touch.show(RING, 30.0)
        with raises(SmartTouchError):
            touch.show(RING, 0.1)
    sent = len(results)
    with raises(BoardError):
        touch._display.board.send(results[-1].sequence)
    assert len(results) == sent


def test_a_session_is_recorded_and_logged_and_nothing_is_printed(tmp_path, caplog, capfd):
    caplog.set_level("INFO", "smarttouch")
    path, events = tmp_path / "session.mcap", []
    touch, results = session("simulated:", listeners=[st.Recorder(path), OnEvent(events.append)])
    with touch:
        touch.show(RING, 0.3)
    assert len([*RecordedRun(path).steps()]) == len(results)
    assert_replays(path)
    logged = [each.args[1] for each in caplog.records if each.name == "smarttouch.run"]
    assert logged == events != []
    assert capfd.readouterr() == ("", "")


def putting(touch, ended):
    """Put patterns until the session has ended."""
    while not ended.is_set():
        try:
            touch.put(RING)
        except SmartTouchError:
            return
        time.sleep(0.001)


@pytest.mark.parametrize("url", sample([EMULATOR, "memory:"]))
def test_many_threads_put_until_another_stops(url, tmp_path, runs):
    """No thread deadlocks, and the recording contains every step."""
    rounds = runs or (10 if WHOLE else 3)
    for round_ in range(rounds if url == "memory:" else max(1, rounds // 10)):
        path = tmp_path / f"{round_}.mcap"
        touch, results = session(url, listeners=[st.Recorder(path)])
        ended = threading.Event()
        threads = [threading.Thread(target=putting, args=(touch, ended)) for _ in range(4)]
        with touch:
            for each in threads:
                each.start()
            time.sleep(0.05)
            threads.append(threading.Thread(target=touch.stop))
            threads[-1].start()
            for each in reversed(threads):
                each.join(20)
                assert not each.is_alive()
                ended.set()
        assert touch.statistics.ended == "the session was stopped"
        assert len([*RecordedRun(path).steps()]) == len(results)
