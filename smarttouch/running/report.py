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
        "worst_other": statistics.off_target or None,
        "worst_spill": statistics.spill or None,
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
        "dose_net_uc": board.dose.most_net_uc,
        "emulator_violations": report.violations if report and report.by == "board" else None,
        "active_fraction": statistics.active / statistics.frames if statistics.frames else 0.0,
    }


def summary_lines(figures: dict[str, Any], *, acknowledges: bool) -> list[str]:
    """Return how a run went in lines of text, from the figures of `figures_of`."""
    latency = figures["motion_to_bytes_us"]
    net_uc = figures["max_net_charge_uc"] or 0
    net = (
        f"all pulses add up to {net_uc:.2g} µC on one electrode"
        if figures["reported_by"] == "host"
        else f"net charge left {1e6 * net_uc:.3g} pC at worst"
    )
    lines = [
        f"Ended after {figures['seconds']:.1f} s ({figures['ended']}): all electrodes off.",
        f"{figures['frames_in']} frames in, {figures['frames_felt']} felt, "
        f"{figures['dropped_frames']} dropped; {figures['slots']} slots in "
        f"{figures['acknowledged']} sequences {'acknowledged' if acknowledges else 'sent'}",
        f"{figures['rate_hz']:.1f} Hz of {figures['rate_asked_hz'] or 0:.1f} asked"
        + _slowed(figures)
        + f"; image to last byte {latency['p50'] / 1000:.1f} ms median, "
        f"{latency['p99'] / 1000:.1f} ms p99; own work {figures['work_share']:.1%} of it",
        f"strongest pulse {figures['max_current_ma']:.2f} mA, "
        f"{figures['max_charge_uc']:.3f} µC; {net}",
        f"dose of this session: {figures['dose_s']:.1f} s of current, "
        f"{figures['dose_mc']:.2f} mC through one electrode at most, "
        f"{figures['dose_net_uc']:.3g} µC left of one sign",
        f"{_pulses(figures)} pulses by the host's own account: this board keeps none"
        if figures["reported_by"] == "host"
        else f"{figures['emulator_violations']} violations by the board's own books",
    ]
    if figures["worst_other"] is not None:
        lines.append(
            f"points shared slots: other classes got {figures['worst_other']:.2f} of them at "
            f"worst, their own elsewhere {figures['worst_spill']:.2f}"
        )
    if figures["lifts"]:
        lines.append(f"the finger was lifted {figures['lifts']} times")
    blind = figures["without_force_or_image"]
    if blind:
        lines.append(f"{blind} sequences without current: force or image were not known")
    return lines


def _slowed(figures: dict[str, Any]) -> str:
    if not figures["slowed_sequences"]:
        return ""
    return (
        f" ({figures['slowed_sequences']} sequences did not fit and were slowed, "
        f"at most to {figures['lowest_rate_hz']:.1f} Hz)"
    )


def _pulses(figures: dict[str, Any]) -> str:
    """Return a number of pulses, or the two between which it is."""
    least, most = figures["pulses"], figures["pulses_at_most"]
    return str(least) if least == most else f"{least} to {most}"
