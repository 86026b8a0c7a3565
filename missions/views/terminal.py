"""The view in a terminal of 80 by 24, e.g. over ssh: tree, statuses, adaptations and events.

It shows the last row of each track and key, as the page does.
"""

import sys
from collections.abc import Iterator
from itertools import islice
from operator import itemgetter
from typing import Any, ClassVar, Final

from missions.engine.mission import MissionError, needs
from missions.views.live import Steering
from missions.views.recorder import Recorder
from missions.views.report import LOGGED, Rows

with needs("tui", "the view in a terminal"):
    from rich.text import Text
    from textual.app import App, ComposeResult
    from textual.containers import VerticalScroll
    from textual.widgets import Footer, Header, Input, Static

_PERIOD_S: Final = 0.2
_MOST: Final = 400
"""The largest number of entries of a list."""
_STYLES: Final = {
    "R": ("▶", "blue"),
    "S": ("✓", "green"),
    "F": ("✕", "red"),
    "": ("·", "dim"),
    "solved": ("✓", "green"),
    "feasible": ("○", "green"),
    "unfeasible": ("✕", "red"),
    "failure": ("✕", "red"),
}
"""Sign and colour of a status, of a behaviour or an element."""
_LEVELS: Final = {"info": "blue", "warning": "yellow", "error": "bold red"}


def _tree(rows: Rows) -> Iterator[Text]:
    """Yield a line for each behaviour: status, name, feedback."""
    statuses = rows.last("node")
    depths: dict[int, int] = {}
    for tree in rows.last("tree").values():
        for uid, parent, _, name, _, _ in tree["nodes"]:
            depths[uid] = depths.get(parent, -1) + 1
            status, feedback = statuses.get(uid) or ("", "")
            yield Text("  " * depths[uid]) + _line(status.upper(), name, feedback)


def _known(rows: Rows) -> Iterator[Text]:
    """Yield actions, functions and components with status, choice and reason; measurements."""
    elements = {key: value for key, value in rows.last("element").items() if value is not None}
    facts = {name: rows.last(name) for name in ("required", "active", "selected", "stale")}
    statuses = rows.last("status")
    reasons = rows.last("why")
    for kind in ("action", "function", "component"):
        yield Text(f"{kind}s", "bold")
        for key, element in elements.items():
            if element["kind"] == kind:
                status = statuses.get(key, "")
                words = [element["name"]]
                words += [fact for fact in ("required", "active") if facts[fact].get(key)]
                parts = [part for part in element["requires"] if facts["selected"].get(part)]
                words += [elements[part]["name"] for part in parts]
                is_lost = status in ("unfeasible", "failure")
                yield _line(status, " ".join(words), reasons.get(key, "") if is_lost else "")
    yield Text("measurements", "bold")
    for key, value in (rows.last("value") | rows.last("signal")).items():
        if value is not None:
            element = elements.get(key, {"name": key, "unit": ""})
            stale = "stale" if facts["stale"].get(key) else ""
            yield _line("", f"{element['name']} {value:.4g} {element['unit']}", stale)


def _line(status: str, text: str, more: str) -> Text:
    sign, style = _STYLES.get(status, ("!", "yellow"))
    return Text.assemble((f"{sign} ", style), text, (f"  {more}", "dim"))


def _adaptations(rows: Rows) -> Iterator[Text]:
    """Yield the adaptations, the latest first: time, change and cause."""
    for entry in islice(reversed(rows.last("adaptation").values()), _MOST):
        time = (f"{entry['t']:7.1f} s  ", "dim")
        yield Text.assemble(time, (entry["changed"], "bold"), (f"\n{'':11}{entry['cause']}", "dim"))


def _log(rows: Rows, words: str) -> Iterator[Text]:
    """Yield the entries of the event log that have the words, the latest first."""
    entries: list[dict[str, Any]] = []
    for track in LOGGED:
        entries += islice(reversed(rows.last(track).values()), _MOST)
    for entry in sorted(entries, key=itemgetter("t"), reverse=True):
        level = entry["level"]
        text = entry["words"]
        if all(word in f"{level} {text}".casefold() for word in words.casefold().split()):
            time = (f"{entry['t']:7.1f} s  ", "dim")
            yield Text.assemble(time, (f"{level:<8}", _LEVELS[level]), text)


class TerminalView(App[None]):
    """Shows the rows of a recorder until the user leaves with `q`.

    Args:
        steering: pauses the run and has it go on; None for a run that can only be watched.
    """

    CSS = """
    Screen { layout: grid; grid-size: 2 2; }
    .known { row-span: 2; }
    VerticalScroll { border: round $primary; padding: 0 1; }
    VerticalScroll:focus { border: round $accent; }
    .hidden, Input.hidden { display: none; }
    Input { dock: bottom; }
    """
    BINDINGS: ClassVar[Any] = [
        ("q", "quit", "leave"),
        ("tab", "focus_next", "next pane"),
        ("l", "log", "event log"),
        ("slash", "filter", "filter"),
        ("space", "hold", "pause or go on"),
    ]
    PANES: Final = ("tree", "known", "adaptations", "log")

    def __init__(self, recorder: Recorder, steering: Steering | None = None) -> None:
        super().__init__()
        self.title = str(recorder.header.get("title", ""))
        self._rows = recorder.rows
        self._steering = steering
        self._shown = {name: Static(id=name) for name in self.PANES}
        self._filter = Input(placeholder="words that an entry must have", classes="hidden")

    def run(self, *arguments: Any, **options: Any) -> None:  # noqa: ANN401  # as in its base
        """Show the view until it is left; MissionError if there is no terminal."""
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise MissionError("--tui shows a run in a terminal, and here is none; use --live")
        super().run(*arguments, **options)

    def compose(self) -> ComposeResult:
        yield Header()
        for name, shown in self._shown.items():
            pane = VerticalScroll(shown, classes="hidden" if name == "log" else name)
            pane.border_title = name
            yield pane
        yield self._filter
        yield Footer()

    def on_mount(self) -> None:
        self.set_interval(_PERIOD_S, self.look)

    def action_log(self) -> None:
        """Show the event log in the place of the adaptations, or these again."""
        for name in ("log", "adaptations"):
            parent = self._shown[name].parent
            if isinstance(parent, VerticalScroll):
                parent.toggle_class("hidden")

    def action_filter(self) -> None:
        """Ask for the words that an entry of the log must have."""
        self._filter.remove_class("hidden")
        self._filter.focus()

    def on_input_submitted(self) -> None:
        self._filter.add_class("hidden")
        self.set_focus(None)
        self.look()

    def action_hold(self) -> None:
        """Pause the run, or have it go on."""
        if self._steering is not None:
            self._steering.do({"do": "resume" if self._steering.state["paused"] else "pause"})

    def look(self) -> None:
        rows = self._rows
        words = [f"{rows.now:.1f} s"]
        for ended in rows.last("result").values():
            words.append(ended["words"])
        if self._steering is not None and self._steering.state["paused"]:
            words.append(f"paused {self._steering.state['stopped']}".strip())
        self.sub_title = "  ".join(words)
        lines = {
            "tree": _tree(rows),
            "known": _known(rows),
            "adaptations": _adaptations(rows),
            "log": _log(rows, self._filter.value),
        }
        for name, shown in self._shown.items():
            shown.update(Text("\n").join(lines[name]))
