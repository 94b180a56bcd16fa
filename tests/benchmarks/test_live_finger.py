"""The live loop with a finger drawn beside it, and without.

Run with::

    pytest tests/benchmarks/test_live_finger.py --benchmark-only -n0

Lines of text on the board emulator; a finger feels the newest step in a process of its own, and a
picture is made of it.
"""

import pytest

import smarttouch as st
from smarttouch.views.live_finger import LiveFinger


@pytest.mark.timeout(0)
@pytest.mark.parametrize("anatomy", [None, "paper", "branched"])
def test_period_error_with_a_finger(row, quick, anatomy):
    profile, seconds = st.load_profile("electric-mouse"), 1.0 if quick else 20.0
    live = None if anatomy is None else LiveFinger(st.Finger(profile, 1, anatomy))
    source = st.open_source(f"text:{'the quick brown fox jumps over the lazy dog ' * 6}", profile)
    with st.open_display("emulator:", profile) as display:
        statistics = st.run(
            source, display, seconds=seconds, listeners=[] if live is None else [live]
        )
    figures = statistics.figures
    error, latency = figures["period_error_us"], figures["latency_us"]
    row(
        f"The live loop beside a finger, {seconds:g} s each",
        {
            "finger": anatomy or "none",
            "sequences": figures["sequences"],
            "felt": "" if live is None else live.simulated,
            "period off by, µs, p50 / p99 / max": " / ".join(
                f"{error[each]:.0f}" for each in ("p50", "p99", "max")
            ),
            "frame to bytes, µs, p50 / p99": f"{latency['p50']:.0f} / {latency['p99']:.0f}",
            "real-time priority": statistics.real_time,
        },
    )
    assert figures["emulator_violations"] == 0
    if live is not None:
        assert live.simulated > 0
        # A step that the board lost is felt, and is no sequence.
        assert live.simulated + live.skipped >= figures["sequences"]
