"""
Catch errors
============

Every error that a user can cause is a `SmartTouchError`. Its message names the wrong value and what
to do. Programs catch it by its class; the command line prints it and exits with status 2.
"""

from pathlib import Path
from tempfile import mkdtemp

import smarttouch as st


def show(error: st.SmartTouchError) -> None:
    """Print the class and the message of an error."""
    print(f"{type(error).__name__}: {error}\n")


# %%
# Open a source, a board and a profile that do not exist, and set an intensity that is too high.
profile = st.load_profile("electric-mouse")
wrong = {
    st.SourceError: lambda: st.open_source("camera:kitchen", profile),
    st.BoardError: lambda: st.open_display("nothing:", profile),
    st.ProfileError: lambda: st.load_profile("my-profile"),
    st.SmartTouchError: lambda: st.RunConfig(mode="RA", intensity=1.5),
}
for kind, call in wrong.items():
    try:
        call()
    except kind as error:
        show(error)
    else:
        raise AssertionError(f"{kind.__name__} was not raised")

# %%
# Design the kernel of a class and a site. This array has the sites 0 to 6: site 7 is an error.
line = st.load_profile("line-7")
kernel = st.design_kernel(line, "SAI", 3)
print(f"site 3: off-target {kernel.off_target:.3f}, at {kernel.off_target_class.name}\n")
try:
    st.design_kernel(line, "SAI", 7)
except st.SmartTouchError as error:
    show(error)

# %%
# A recorder does not overwrite a file.
path = Path(mkdtemp()) / "run.mcap"
path.write_bytes(b"mine")
try:
    with st.open_display("simulated:", profile) as display:
        source = st.open_source("text:a", profile)
        st.run(source, display, listeners=[st.Recorder(path)])
except st.SmartTouchError as error:
    show(error)
assert path.read_bytes() == b"mine"
