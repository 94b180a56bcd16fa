"""A run in a cell of a real Jupyter kernel, interrupted as its stop button does."""

import time

import pytest

from smarttouch.emulator.firmware import read_slots, read_state

ANSWERS_WITHIN_S = 60

jupyter_client = pytest.importorskip("jupyter_client", reason="jupyter_client is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")

RUN = """
import pathlib
import smarttouch as st

profile = st.load_profile("electric-mouse")
display = st.open_display("emulator:", profile, books=pathlib.Path({folder!r}))
steps = []
def follow(result):
    steps.append(result)
    if len(steps) == 50:
        print("in full swing", flush=True)
statistics = st.run(
    st.open_source("text:a long line of text", profile), display, listeners=[follow], seconds=60
)
"""


@pytest.fixture
def kernel(monkeypatch, tmp_path):
    """A kernel, and a client of it."""
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    manager, client = jupyter_client.manager.start_new_kernel(kernel_name="python3")
    yield manager, client
    client.stop_channels()
    manager.shutdown_kernel(now=True)


def printed(client, word):
    """Return what a cell prints, up to a word."""
    text, deadline = "", time.monotonic() + ANSWERS_WITHIN_S
    while word not in text and time.monotonic() < deadline:
        content = client.get_iopub_msg(timeout=ANSWERS_WITHIN_S)["content"]
        text += content.get("text", "") + "".join(content.get("traceback", ()))
    return text


def test_an_interrupted_cell_ends_at_zero(kernel, tmp_path):
    manager, client = kernel
    books = tmp_path / "books"
    books.mkdir()
    cell = client.execute(RUN.format(folder=str(books)))
    assert "in full swing" in printed(client, "in full swing")
    manager.interrupt_kernel()
    reply = None
    while reply is None or reply["parent_header"]["msg_id"] != cell:
        reply = client.get_shell_msg(timeout=ANSWERS_WITHIN_S)
    assert reply["content"]["ename"] == "KeyboardInterrupt"
    state = read_state(books)
    assert (state["state"], state["reason"], state["violations"]) == ("shorted", "stop", 0)
    slots = len(read_slots(books))
    assert slots > 0
    # The kernel lives, and what the cell has made is there.
    client.execute("print('followed', len(steps))")
    assert int(printed(client, "followed").rpartition("followed")[2]) >= 50
    assert len(read_slots(books)) == slots
