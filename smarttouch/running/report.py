"""Figures of a run that has ended, as names and numbers."""

from typing import Any

from smarttouch.boards.board import Board, BoardReport
from smarttouch.running.statistics import RunStatistics
from smarttouch.sources.source import Source


def figures_of(
    statistics: RunStatistics,
    source: Source,
    board: Board,
    report: BoardReport | None,
    ended: str,
) -> dict[str, Any]:
    """Return the figures of a run, ready for JSON; the board's own are None after a fault."""
    return {
        "ended": ended,
        "seconds": statistics.seconds,
        "frames": statistics.frames,
        "frames_in": source.frames,
        "frames_felt": statistics.felt,
        "dropped_frames": source.dropped_frames + statistics.seen - statistics.felt,
        "sequences": statistics.frames,
        "slots": statistics.slots,
        "worst_other": statistics.worst_other or None,
        "worst_spill": statistics.worst_spill or None,
        "pulses": report and report.pulses,
        "pulses_at_most": report and (report.most_pulses or report.pulses),
        "acknowledged": board.acknowledged,
        "refused": board.refused,
        "late_frames": statistics.late,
        "without_force_or_image": statistics.blind,
        "replaced": board.replaced,
        "packets_refused_by_host": board.refused_packets,
        "packets_refused_by_board": report and report.refused_packets,
        "dropped_late": board.dropped_late,
        "restarts": statistics.restarts,
        "lifts": statistics.lifts,
        "reported_by": report and report.by,
        "rate_asked_hz": 1e6 * statistics.frames / statistics.asked_us
        if statistics.asked_us
        else None,
        "rate_hz": statistics.frames / statistics.seconds if statistics.seconds else 0.0,
        "lowest_rate_hz": statistics.lowest_rate_hz if statistics.frames else None,
        "slowed_sequences": statistics.slowed,
        "latency_us": statistics.latency.figures(),
        "motion_to_bytes_us": statistics.motion_to_bytes.figures(),
        "real_time": statistics.real_time,
        "period_error_us": statistics.period_error.figures(),
        "work_us": statistics.work.figures(),
        "work_share": statistics.work_share,
        "max_current_ma": report and report.max_current_ma,
        "max_charge_uc": report and report.max_charge_uc,
        "max_net_charge_uc": report and report.max_net_charge_uc,
        "dose_s": board.dose.seconds,
        "dose_mc": board.dose.most_mc,
        "emulator_violations": report.violations if report and report.by == "board" else None,
        "active_fraction": statistics.active / statistics.frames if statistics.frames else 0.0,
    }
