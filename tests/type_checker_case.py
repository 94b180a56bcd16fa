"""Test case for type checkers: they must report each marked misspelling. It never runs."""

from pathlib import Path

import numpy as np

import smarttouch as st


class Strongest(st.Lisener):  # wrong
    """Listener with a misspelled base class."""


def misspell(path: Path) -> None:
    """Use misspelled names in a run, a session and a recording."""
    profile = st.load_profil("electric-mouse")  # wrong
    whole: st.Profile = st.load_profile(nam="electric-mouse")  # wrong
    print(profile, whole.electrods)  # wrong
    print(whole.limits.curent_ma)  # wrong
    good = st.open_display("simulated:")
    print(good.on_finger)  # wrong
    st.run("text:a", good, st.RunConfig(second=1))  # wrong
    with good.session(mode="RA", intensity=0.5) as touch:
        touch.raise_level(0.5)  # wrong
        shown = touch.show(np.zeros(64, np.float32), second=0.5)  # wrong
        print(touch.statistic, shown)  # wrong
        touch.put(np.zeros(64, np.float32), stale=0.5)  # wrong
    config = st.RunConfig(intensty=1.0)  # wrong
    print(config.subjet)  # wrong
    run = st.load_recording(path)
    print(run.array.time_ns)  # wrong
    print(st.Afferent.RAI)  # wrong
    try:
        st.replay(path, good)
        print(st.RunConfig(mode="RA").mod)  # wrong
    except st.SafetyEror:  # wrong
        raise
