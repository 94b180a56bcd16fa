"""Options that every command takes that runs, said once; and what a run is made of by them."""

import functools
import inspect
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from smarttouch.cli.options import (
    FeltOption,
    ForceOption,
    FramesOption,
    IntensityOption,
    JsonOption,
    MarkersOption,
    ProfileOption,
    QuietOption,
    RecordOption,
    ScanOption,
    SecondsOption,
)

if TYPE_CHECKING:
    from smarttouch.cli.session import Outputs
    from smarttouch.profile import Profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.display import Display
    from smarttouch.sources.forces.force import ForceSource

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run, as typed."""

    board: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="emulator:, simulated: (waits for nothing), kajimoto61:PORT, etactilekit:PORT, "
            "link:PORT; emulator: if none.",
        ),
    ] = None
    vibrators: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Mechanical vibrators, to shake PC instead of current."),
    ] = None
    profile: ProfileOption = None
    force: ForceOption = None
    intensity: IntensityOption = None
    scan: ScanOption = "auto"
    softness: Annotated[
        float | None,
        typer.Option(metavar="0..1", help="1: SAI pulses at a constant rate; 0: follows force."),
    ] = None
    seconds: SecondsOption = None
    measure: Annotated[
        bool, typer.Option("--measure", help="First find bad electrodes, and plan around them.")
    ] = False
    hold: Annotated[
        str | None,
        typer.Option(metavar="charge|energy", help="Against drifting impedance, if the board can."),
    ] = None
    balance: Annotated[
        bool,
        typer.Option(
            "--balance",
            help="Keep net charge at zero, by a weak recharge phase in each scan. Boards of one "
            "source reverse scans instead, and those drive the other class (SAI for RA).",
        ),
    ] = False
    felt: FeltOption = None
    frames: FramesOption = None
    record: RecordOption = None
    subject: Annotated[str, typer.Option(help="Who feels it, for the recording.")] = ""
    note: Annotated[str, typer.Option(help="Anything else, for the recording.")] = ""
    markers: MarkersOption = False
    json_file: JsonOption = None
    quiet: QuietOption = False

    @property
    def board_url(self) -> str:
        """URL of the board; the emulator if none was given."""
        return self.board or "emulator:"

    @property
    def on_a_finger(self) -> bool:
        """Whether there may be a finger on the board."""
        from smarttouch.boards.board import may_touch_a_finger

        return may_touch_a_finger(self.board_url)

    @property
    def pressed(self) -> bool:
        """Whether force has to be made up: nobody measures it, and no finger is there."""
        return self.force is None and not self.on_a_finger

    def load_profile(self) -> "Profile":
        """Return the profile that was asked for, or the board's usual one."""
        from smarttouch.boards.board import usual_profile
        from smarttouch.profile import load_profile

        return load_profile(self.profile or usual_profile(self.board_url))

    def display(self, profile: "Profile") -> "Display":
        """Return the display, not opened yet."""
        from smarttouch.running.display import Display

        return Display(self.board_url, profile, self.vibrators)

    def config(self, mode: str, **more: Any) -> "RunConfig":
        """Return the configuration of the run; settings that a command adds go first."""
        from smarttouch.running.config import RunConfig

        return RunConfig(**(self.settings() | {"mode": mode} | more))

    def settings(self, *but: str) -> dict[str, Any]:
        """Return the settings of `RunConfig` that were given, without some."""
        names = (
            "scan", "seconds", "intensity", "softness", "measure", "hold", "balance", "subject",
            "note",
        )  # fmt: skip
        return {name: getattr(self, name) for name in names if name not in but}

    def outputs(self) -> "Outputs":
        """Return the files of the run."""
        from smarttouch.cli.session import Outputs

        return Outputs(**{each.name: getattr(self, each.name) for each in fields(Outputs)})

    def open_force(self, profile: "Profile", stack: ExitStack) -> "ForceSource | None":
        """Return the source of force that was asked for, closed with the stack."""
        if self.force is None:
            return None
        from smarttouch.sources.forces.force import open_force

        return stack.enter_context(open_force(self.force, profile))


def takes_run_options(
    **defaults: Any,
) -> Callable[[Callable[..., _T]], Callable[..., _T]]:
    """Let a command take each option of `RunOptions`; it is given all of them as ``run``.

    An option that the command names itself is its own.

    Parameters
    ----------
    **defaults
        Of options that have another default in this command.
    """
    return functools.partial(_expanded, defaults=defaults)


def _expanded(command: Callable[..., _T], defaults: dict[str, Any]) -> Callable[..., _T]:
    hints = get_type_hints(command, include_extras=True)
    options = get_type_hints(RunOptions, include_extras=True)
    parameters = inspect.signature(command).parameters
    own = [
        each.replace(annotation=hints[each.name]) for each in parameters.values()
        if each.name != "run"
    ]  # fmt: skip
    shared = [each for each in fields(RunOptions) if each.name not in parameters]

    @functools.wraps(command)
    def expanded(**given: Any) -> _T:
        of_run = {each.name: given.pop(each.name) for each in shared}
        return command(run=RunOptions(**of_run), **given)

    del expanded.__wrapped__
    more = [
        inspect.Parameter(
            each.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=defaults.get(each.name, each.default),
            annotation=options[each.name],
        )
        for each in shared
    ]
    own = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in own]
    signature = inspect.Signature([*own, *more], return_annotation=hints.get("return"))
    expanded.__signature__ = signature  # type: ignore[attr-defined]
    expanded.__annotations__ = {
        each.name: each.annotation for each in signature.parameters.values()
    }
    return expanded
