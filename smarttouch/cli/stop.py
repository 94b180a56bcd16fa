"""``smarttouch stop``: end every run on this machine, from another terminal."""

import typer


def stop() -> None:
    """Ask every run of this user to end with all electrodes at zero, and wait until they have.

    What was started before and has not begun yet does not begin.
    """
    import contextlib
    import os
    import signal
    import time

    from smarttouch.cli.run_registry import leave_mark, running
    from smarttouch.errors import SmartTouchError

    # First the mark: who is not listed yet will find it before it begins.
    no_mark: SmartTouchError | None = None
    try:
        leave_mark()
    except SmartTouchError as error:
        no_mark = error
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
            f"{left[0]}): switch the board off",
            about="runs",
            problem="late",
            value=tuple(left),
            allowed=_WAIT_S,
        )
    if no_mark is not None:
        raise no_mark
    # Who is started after this is newer than the mark, in the system's steps of 10 ms too.
    time.sleep(0.02)
    typer.echo(f"{len(asked)} stopped." if asked else "Nothing runs.")


_WAIT_S = 3.0
