"""
Record a run, and replay it in your tests
=========================================

A recording keeps frames, forces, sequences and all settings in one file. Replayed through today's
program it gives the same sequences to the last microampere, or a list of differences: a test that
shows when a change of yours, or of SmartTouch, changes what a finger would feel.
"""

from pathlib import Path
from tempfile import mkdtemp

import smarttouch as st
from smarttouch.lab import assert_replays, check_recording

path = Path(mkdtemp()) / "line-1.mcap"

# %%
# Record.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:touch", profile, speed_mm_s=60)
with st.open_display("simulated:", profile) as display:
    st.run(source, display, mode="RA", listeners=[st.Recorder(path)])
print(f"{path.name}: {path.stat().st_size // 1000} kB")

# %%
# In a test of yours this is a line; pytest finds the fixture ``replays`` by itself, which does it
# too. It raises an AssertionError that lists the differences.
assert_replays(path)

# %%
# A change that a finger would feel does not pass: here full intensity at a lighter touch.
changed = profile.model_dump()
changed["force"]["full_n"] *= 0.9
report = check_recording(path, profile=st.Profile.model_validate(changed))
print("\n".join(report.describe().splitlines()[:3]))
assert not report.exact

# %%
# The same frames on another display, say with other kernels or another board.
with st.open_display("simulated:", profile) as display:
    statistics = st.replay(path, display)
print(f"{statistics.slots} slots once more")
