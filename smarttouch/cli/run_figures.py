"""What ``--json`` writes of a run."""

from typing import Any

from smarttouch.boards.board import Board, BoardReport
from smarttouch.sources.frame import Sensor
from smarttouch.tally import Tally


def run_figures(
    tally: Tally,
    source: Sensor,
    board: Board,
    report: BoardReport | None,
    ended: str,
) -> dict[str, Any]:
    """Return the figures of a run; the board's own are None after a fault."""
    return {
        "ended": ended,
        "seconds": tally.seconds,
        "frames": tally.frames,
        "frames_in": source.frames,
        "frames_felt": tally.felt,
        "dropped_frames": source.dropped_frames + tally.seen - tally.felt,
        "sequences": tally.frames,
        "slots": tally.slots,
        "worst_other": tally.worst_other or None,
        "worst_spill": tally.worst_spill or None,
        "pulses": report and report.pulses,
        "pulses_at_most": report and (report.most_pulses or report.pulses),
        "acknowledged": board.acknowledged,
        "refused": board.refused,
        "late_frames": tally.late,
        "without_force_or_image": tally.blind,
        "replaced": board.replaced,
        "packets_refused_by_host": board.refused_packets,
        "packets_refused_by_board": report and report.refused_packets,
        "dropped_late": board.dropped_late,
        "restarts": tally.restarts,
        "lifts": tally.lifts,
        "reported_by": report and report.by,
        "rate_asked_hz": 1e6 * tally.frames / tally.asked_us if tally.asked_us else None,
        "rate_hz": tally.frames / tally.seconds if tally.seconds else 0.0,
        "lowest_rate_hz": tally.lowest_rate_hz if tally.frames else None,
        "slowed_sequences": tally.slowed,
        "latency_us": tally.latency.figures(),
        "motion_to_bytes_us": tally.motion_to_bytes.figures(),
        "real_time": tally.real_time,
        "period_error_us": tally.period_error.figures(),
        "work_us": tally.work.figures(),
        "work_share": tally.work_share,
        "max_current_ma": report and report.max_current_ma,
        "max_charge_uc": report and report.max_charge_uc,
        "max_net_charge_uc": report and report.max_net_charge_uc,
        "dose_s": board.dose.seconds,
        "dose_mc": board.dose.most_mc,
        "emulator_violations": report.violations if report and report.by == "board" else None,
        "active_fraction": tally.active / tally.frames if tally.frames else 0.0,
    }
