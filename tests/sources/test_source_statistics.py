"""Statistics of a source, as ``devices show`` prints them."""

import smarttouch as st
from smarttouch.sources.source_statistics import sample_source


def test_the_rate_is_that_of_the_reads():
    with st.open_source("text:touch", st.load_profile("electric-mouse")) as source:
        rows = dict(sample_source(source, 0.2))
    assert rows["frames"] == "21, 100.0 a second"
