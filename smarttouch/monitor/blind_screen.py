"""Terminal screen of a participant, which never reveals the answer."""

from rich.console import Group
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from smarttouch.events import Event
from smarttouch.monitor.screen import Screen, bar

_BLIND_KEYS = "+ − amplitude    0 none    space pause    q, Esc end, goes on another time"


class BlindScreen(Screen):
    """Shows question, amplitude and pressure; no electrodes, rates or currents."""

    def event(self, event: Event) -> None:
        if not self.hides(event):
            super().event(event)

    def hides(self, event: Event) -> bool:
        return event.reveals

    def _render(self) -> Group | Text:
        sent = self._latest
        if sent is None:
            return Text("waiting for the first frame")
        frame = sent.step.input
        table = Table.grid(padding=(0, 1))
        for name, part in (
            ("amplitude", self._controls.state(frame.time_ns).level),
            ("pressure", frame.force_n / self._profile.force.full_n),
        ):
            table.add_row(Text(name, style="dim"), Text(bar(part, 20)))
        where, _, now = self._source.title.partition(": ")
        return Group(
            Text(where, style="dim"),
            Panel(Text(now or " ", style="bold", justify="center"), width=72, padding=(1, 2)),
            table,
            Text(_BLIND_KEYS, style="dim"),
            Text(self._event, style="dim"),
        )
