"""Options of every command that runs, defined once, and the parts of a run made by them."""

from contextlib import nullcontext
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smarttouch.base.files import require_folder
from smarttouch.cli.options import (
    BOARD,
    FINGER,
    KEPT,
    AnatomyOption,
    FingerOption,
    ForceOption,
    JsonOption,
    OptionGroup,
    ProfileOption,
    QuietOption,
    ScanOption,
)

if TYPE_CHECKING:
    from smarttouch.profile import Profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.display import Display
    from smarttouch.sources.source_contract import Source


@dataclass(frozen=True, kw_only=True)
class RunOptionGroup(OptionGroup):
    """Options of a run, as typed."""

    board: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            rich_help_panel=BOARD,
            help="emulator: if none; simulated:, kajimoto61:, etactilekit:, link: and a port.",
        ),
    ] = None
    vibrators: Annotated[
        str | None,
        typer.Option(
            metavar="URL", rich_help_panel=BOARD, help="To shake what PC is to feel; no current."
        ),
    ] = None
    scan: ScanOption = None
    measure: Annotated[
        bool,
        typer.Option("--measure", rich_help_panel=BOARD, help="Find and avoid bad electrodes."),
    ] = False
    hold: Annotated[
        str | None,
        typer.Option(
            metavar="WHAT", rich_help_panel=BOARD, help="charge or energy, as impedance drifts."
        ),
    ] = None
    balance: Annotated[
        bool,
        typer.Option(
            "--balance",
            rich_help_panel=BOARD,
            help="Net charge zero: a weak recharge; of one source reversed scans, which drive the "
            "other class.",
        ),
    ] = False
    profile: ProfileOption = None
    force: ForceOption = None
    intensity: Annotated[
        float | None,
        typer.Option(
            metavar="0..1",
            rich_help_panel=FINGER,
            help="At most, of the strongest; real boards begin at 0.",
        ),
    ] = None
    softness: Annotated[
        float | None,
        typer.Option(
            metavar="0..1",
            rich_help_panel=FINGER,
            help="SAI pulses at one rate (1), or as force has it (0).",
        ),
    ] = None
    seconds: Annotated[float | None, typer.Option(metavar="S", help="Longest run, wall time.")] = (
        None
    )
    felt: Annotated[
        Path | None,
        typer.Option(metavar="PNG", rich_help_panel=KEPT, help="Picture of what is read and felt."),
    ] = None
    finger: FingerOption = 1
    anatomy: AnatomyOption = "branched"
    frames: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            rich_help_panel=KEPT,
            help="What electrodes do: .gif, .json, folder of PNG.",
        ),
    ] = None
    record: Annotated[
        Path | None, typer.Option(metavar="MCAP", rich_help_panel=KEPT, help="The whole run.")
    ] = None
    subject: Annotated[
        str,
        typer.Option(metavar="NAME", rich_help_panel=KEPT, help="Who feels it, for the recording."),
    ] = ""
    note: Annotated[
        str,
        typer.Option(
            metavar="TEXT", rich_help_panel=KEPT, help="Anything else, for the recording."
        ),
    ] = ""
    markers: Annotated[
        bool,
        typer.Option(
            "--markers", rich_help_panel=KEPT, help="Events to the Lab Streaming Layer (extra lsl)."
        ),
    ] = False
    foxglove: Annotated[
        int | None,
        typer.Option(metavar="PORT", rich_help_panel=KEPT, help="For Foxglove, live (extra)."),
    ] = None
    json_file: JsonOption = None
    window: Annotated[
        int | None,
        typer.Option(metavar="[PORT]", help="Page in a browser."),
    ] = None
    quiet: QuietOption = False
    plain: Annotated[
        bool | None,
        typer.Option("--plain", help="Print a line per event; draw nothing."),
    ] = None

    def __post_init__(self) -> None:
        for output in (self.felt, self.record, self.json_file):
            require_folder(output)

    @property
    def board_url(self) -> str:
        """URL of the board: that given, that of the profile given, or the emulator."""
        return self.board or (self._chosen and self._chosen.defaults.board) or "emulator:"

    @property
    def on_a_finger(self) -> bool:
        """True if there may be a finger on the board."""
        from smarttouch.boards.open import may_touch_a_finger

        return may_touch_a_finger(self.board_url)

    @cached_property
    def _chosen(self) -> "Profile | None":
        from smarttouch.profile import load_profile

        return None if self.profile is None else load_profile(self.profile)

    def load_profile(self) -> "Profile":
        """Return the profile that was asked for, or the board's usual one."""
        from smarttouch.boards.open import default_profile
        from smarttouch.profile import load_profile

        return self._chosen or load_profile(default_profile(self.board_url))

    def display(self, profile: "Profile") -> "Display":
        """Return the display, not opened yet."""
        from smarttouch.running.display import Display

        return Display(self.board_url, profile, self.vibrators)

    def config(self, mode: str, **more: Any) -> "RunConfig":
        """Return the configuration of the run; settings that a command adds go first."""
        from smarttouch.running.config import RunConfig

        return RunConfig(**(self.settings() | {"mode": mode} | more))

    def settings(self, *but: str) -> dict[str, Any]:
        """Return the settings of `RunConfig` that were given, but for some."""
        names = (
            "scan", "seconds", "intensity", "softness", "measure", "hold", "balance", "subject",
            "note",
        )  # fmt: skip
        given = {name: getattr(self, name) for name in names if name not in but}
        # A command or its source has a usual way to scan.
        return {name: value for name, value in given.items() if (name, value) != ("scan", None)}

    def start(
        self,
        source: "Source",
        profile: "Profile",
        config: "RunConfig",
        **more: Any,
    ) -> None:
        """Run a source in the terminal until its end; `more` is for `run_in_terminal`."""
        from smarttouch.sources.force import open_force
        from smarttouch.views.terminal_session import Outputs, run_in_terminal

        given = {each.name: getattr(self, each.name) for each in fields(Outputs)}
        plain = profile.defaults.plain if self.plain is None else self.plain
        outputs = Outputs(**given | {"plain": plain})
        with nullcontext() if self.force is None else open_force(self.force, profile) as force:
            display = self.display(source.narrowed(profile) if self.on_a_finger else profile)
            run_in_terminal(source, display, config, outputs, force=force, **more)
