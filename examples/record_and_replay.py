"""
Record a run, and replay it in your tests
=========================================

A recording stores frames, forces, sequences and all settings in one file. A test can process the
recorded frames again and compare the new sequences with the recorded sequences, exactly to the
microampere. The test fails if a change of your code or of SmartTouch changes what a finger feels.
"""

from pathlib import Path
from tempfile import mkdtemp

import smarttouch as st
from smarttouch.lab import assert_replays, check_recording

path = Path(mkdtemp()) / "line-1.mcap"

# %%
# Record a run.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:touch", profile, speed_mm_s=60)
with st.open_display("simulated:", profile) as display:
    st.run(source, display, mode="RA", listeners=[st.Recorder(path)])
print(f"{path.name}: {path.stat().st_size // 1000} kB")

# %%
# Check the recording in your test with `assert_replays`, or with the pytest fixture ``replays``. If
# sequences differ, both raise an AssertionError that lists the differences.
assert_replays(path)

# %%
# Check the recording with a changed profile, which gives full intensity at less force.
changed = profile.model_dump()
changed["force"]["full_n"] *= 0.9
report = check_recording(path, profile=st.Profile.model_validate(changed))
print("\n".join(report.describe().splitlines()[:3]))
assert not report.exact

# %%
# Replay the recorded frames on a display, which may have other kernels or another board.
with st.open_display("simulated:", profile) as display:
    statistics = st.replay(path, display)
print(f"{statistics.slots} slots replayed")
