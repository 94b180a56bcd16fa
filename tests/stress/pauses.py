"""Hosts that are stopped and go on: after a pause, no pulse is above the ramp from zero."""

import json
import math
import os
import random
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from forked import KINDS, Emulated, quiet, run_and_exit

from smarttouch.base.afferent import Mode
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.open import make_board
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.loop import Loop, steady_environment
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import as_listeners
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose
from smarttouch.stimulation.safety_gate import SafetyLimits

PROFILES = {"link": "electric-mouse", "kajimoto61": "kajimoto-61", "etactilekit": "etactilekit-32"}
RISEN_S = 0.7
"""After a pause, until it is at its strongest again."""
DRIVES_WITHIN_S = 60.0
GAP_NS = 150_000_000
"""After such a pause what was due is late."""
RECORD = struct.Struct("<qi")
STEP_UA = 50


class Bars(OpticalSource):
    """A finger that lies on the same bars for ever."""

    knows_force = measures_force = True

    def __init__(self, profile):
        super().__init__("bars")
        optics = profile.optics
        self._image = np.full((optics.sensor_rows, optics.sensor_columns), 230, np.uint8)
        third = optics.sensor_columns // 3
        self._image[:, third : 2 * third] = 20
        self._force_n = profile.force.full_n

    def read(self, time_ns):
        self.frames += 1
        return Frame(self._image, time_ns, Pose(0.0, 0.0), self._force_n, self.frames)


def host(kind, url, folder):
    """Drive a board at its strongest until SIGTERM; write down what was dropped."""
    quiet(folder / f"{kind}.out")
    profile, stop, tally = load_profile(PROFILES[kind]), StopRequest(), RunStatistics()
    pipeline = Pipeline(profile, load_bank(profile), RunConfig(mode=Mode.RA, scan="points"))
    signal.signal(signal.SIGTERM, lambda *_: setattr(stop, "reason", "over"))
    board = make_board(url, SafetyLimits.of(profile), profile.output)
    with steady_environment(pipeline), board:

        def watch(_sent):
            # Set here and not in the handler, which may lock nothing.
            if stop.reason:
                stop.event.set()

        Loop(
            Bars(profile), pipeline, board, stop=stop, statistics=tally,
            listeners=as_listeners([watch]), controls=Controls(ControlState(Mode.RA)),
        ).run()  # fmt: skip
    account = {"dropped_late": board.dropped_late, "restarts": tally.restarts, "late": tally.late}
    (folder / f"{kind}.json").write_text(json.dumps(account))


def stopped_and_judged(kind, count, seed, folder):
    """Stop and continue a host so many times; return what its board got after each pause."""
    draw, trace = random.Random(seed), folder / f"{kind}.trace"
    # Of a user of its own: three drivers at once are beyond the budget of one.
    os.environ["XDG_STATE_HOME"] = str(folder / f"{kind}.state")
    board = Emulated(kind, trace)
    process = os.fork()
    if process == 0:
        run_and_exit(lambda: host(kind, board.url, folder))
    overs_ns = []
    begun = time.monotonic()
    while not board.pulses:
        assert time.monotonic() < begun + DRIVES_WITHIN_S, "nothing flowed"
        time.sleep(0.01)
    for _ in range(count):
        time.sleep(RISEN_S + draw.uniform(0.0, 0.1))
        os.kill(process, signal.SIGSTOP)
        begin_ns = time.monotonic_ns()
        time.sleep(0.1 * math.exp(draw.uniform(0.0, math.log(30))))
        over_ns = time.monotonic_ns()
        os.kill(process, signal.SIGCONT)
        if over_ns - begin_ns > GAP_NS:
            overs_ns.append((over_ns, over_ns - begin_ns))
    time.sleep(RISEN_S)
    os.kill(process, signal.SIGTERM)
    os.waitpid(process, 0)
    ended = board.ended()
    profile = load_profile(PROFILES[kind])
    full_ua = 1000 * float(profile.full_ma.max())
    found = judged(trace.read_bytes(), overs_ns, full_ua / profile.limits.ramp_s)
    account = json.loads((folder / f"{kind}.json").read_text())
    return {"board": kind, "stops": count, **found, **account, "wrong": ended["wrong"]}


def judged(trace, overs_ns, ua_per_s):
    """Return how strong pulses were, against the ramp, from the first byte after each pause."""
    records = list(RECORD.iter_unpack(trace[: len(trace) // RECORD.size * RECORD.size]))
    strongest_ua = max(peak for _, peak in records)
    assert strongest_ua > 0, "nothing flowed"
    above, worst, risen, details, left_ns = 0, 0.0, None, [], list(overs_ns)
    away = False
    for time_ns, peak_ua in sorted(records):
        if left_ns and time_ns >= left_ns[0][0]:
            if peak_ua == -1:
                over_ns, pause_ns = left_ns.pop(0)
                # Bytes that a board was too late to read may have come since the pause was over.
                risen, counted = over_ns if away else time_ns, False
            away = peak_ua == -2
        elif risen is not None:
            since_s = (time_ns - risen) / 1e9
            # The first packets are those of two periods; later ones may be in time by 100 ms.
            allowed = ua_per_s * (since_s + (0.04 if since_s < 0.025 else 0.1)) + STEP_UA
            worst = max(worst, peak_ua / allowed)
            if peak_ua > allowed and not counted:
                above, counted = above + 1, True
                after_ms = (risen - over_ns) / 1e6
                details.append((pause_ns / 1e6, after_ms, 1000 * since_s, peak_ua, allowed))
    return {
        "pauses": len(overs_ns), "above": above, "worst": worst, "strongest_ua": strongest_ua,
        "details": details,
        "pulses": sum(peak >= 0 for _, peak in records),
    }  # fmt: skip


def main(count, seed):
    """Do so on every driver at once; print what came of it."""
    with tempfile.TemporaryDirectory() as name:
        folder, processes = Path(name), []
        for kind in KINDS:
            processes.append(os.fork())
            if processes[-1] == 0:
                run_and_exit(
                    lambda kind=kind: (folder / f"{kind}.found").write_text(
                        json.dumps(stopped_and_judged(kind, count, seed, folder))
                    )
                )
        for process in processes:
            os.waitpid(process, 0)
        found = [json.loads((folder / f"{kind}.found").read_text()) for kind in KINDS]
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
