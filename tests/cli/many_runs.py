"""Runs of the program in forked copies of one process: ``many_runs.py FOLDER < runs.json``.

Standard input holds a list of argument lists. A line of JSON is told of each run: its exit
status, its output and errors, and whether it had to be interrupted or even killed. A run that goes
on is interrupted after PATIENCE_S.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

PATIENCE_S = float(os.environ.get("SMARTTOUCH_PATIENCE_S", "5"))
ENDING_S = 10


def many_runs(folder, runs, **environment):
    """Return what came of runs of the program, in order."""
    done = subprocess.run(
        [sys.executable, __file__, folder],
        input=json.dumps(list(runs)),
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def what_is_wrong(done):
    """Return what a run did that no run may do, with what was asked of it; None if nothing."""
    said = done["err"]
    for sign in ("Traceback", "internal error", "Warning", "Exception"):
        if sign in said or "Traceback" in done["out"]:
            return sign, done
    allowed = (0, 130) if done["ended_by"] == "interrupted" else (0, 2)
    if done["code"] not in allowed:
        return "exit status", done
    if done["code"] == 2 and not said:
        return "no sentence", done
    if said.startswith("smarttouch: ") and said.count("\n") != 1:
        return "more than a sentence", done
    return None


def main(folder):
    from smarttouch import cli  # what all copies share

    import_heavy()
    for arguments in json.load(sys.stdin):
        print(json.dumps(one_run(cli, folder, arguments)), flush=True)


def import_heavy():
    import smarttouch.cli.session
    import smarttouch.reading.source
    import smarttouch.recording.check  # noqa: F401


def one_run(cli, folder, arguments):
    outputs = [folder / ".out", folder / ".err"]
    process = os.fork()
    if not process:
        os.chdir(folder)
        os.setsid()
        # Whoever started us may have had it ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, path in enumerate((Path(os.devnull), *outputs)):
            os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600), number)
        sys.argv = ["smarttouch", *arguments]
        code = 0
        try:
            cli.main()
        except SystemExit as ended:
            code = ended.code or 0
        except BaseException:
            import traceback

            traceback.print_exc()
            code = 99
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    ended, status = waited(process, PATIENCE_S), None
    # Twice, as anyone would: this is not the test of what a single Ctrl-C does.
    for number, name in (
        (signal.SIGINT, "interrupted"),
        (signal.SIGINT, "interrupted"),
        (signal.SIGKILL, "killed"),
    ):
        if ended is not None:
            break
        status = name
        os.killpg(process, number)  # as a terminal does
        ended = waited(process, ENDING_S)
    return {
        "arguments": arguments,
        "code": os.waitstatus_to_exitcode(ended),
        "ended_by": status,
        "out": outputs[0].read_text(errors="replace"),
        "err": outputs[1].read_text(errors="replace"),
    }


def waited(process, seconds):
    """Return how a process ended; None if it did not within a time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return status
        time.sleep(0.002)
    return None


if __name__ == "__main__":
    main(Path(sys.argv[1]))
