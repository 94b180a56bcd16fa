"""``smarttouch stop``: end every run on this machine, from another terminal."""

import typer


def stop() -> None:
    """Ask every run of this user to end with all electrodes at zero, and wait until they have."""
    import contextlib
    import os
    import signal
    import time

    from smarttouch.cli.running import running
    from smarttouch.errors import SmartTouchError

    asked = running()
    for process in asked:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)
    deadline = time.monotonic() + _WAIT_S
    while (left := running()) and time.monotonic() < deadline:
        time.sleep(0.02)
    if left:
        raise SmartTouchError(
            f"{len(left)} of {len(asked)} runs have not ended within {_WAIT_S:g} s (process "
            f"{left[0]}): switch the board off"
        )
    typer.echo(f"{len(asked)} stopped." if asked else "Nothing runs.")


_WAIT_S = 3.0
