"""The view in a terminal of 80 by 24, e.g.

Over ssh: tree, statuses, adaptations with reasons, measurements.

It shows the same rows as the page: the last row of each track and key.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Final

from missions.engine.mission import needs
from missions.views.live import Steering
from missions.views.recorder import Recorder
from missions.views.report import NUMBERED

with needs("tui", "the view in a terminal"):
    from rich.text import Text
    from textual.app import App, ComposeResult
    from textual.containers import VerticalScroll
    from textual.widgets import Footer, Header, Input, Static

_PERIOD_S: Final = 0.2
_SPARKS: Final = "▁▂▃▄▅▆▇█"
_KEPT: Final = 400
_STYLES: Final = {
    "R": ("▶", "blue"),
    "S": ("✓", "green"),
    "F": ("✕", "red"),
    "": ("·", "dim"),
    "solved": ("✓", "green"),
    "feasible": ("○", "green"),
    "unsolved": ("…", "yellow"),
    "unfeasible": ("✕", "red"),
    "failure": ("✕", "red"),
}
"""Sign and colour of a status, of a behaviour or an element."""
_LOGGED: Final = {"event": "info", "taskplan": "info", "disturbance": "warning", "problem": "error"}
"""The tracks that the log shows, each with its level unless the entry has its own."""
_LEVELS: Final = {"info": "blue", "warning": "yellow", "error": "bold red"}


class Fold:
    """The last row of each track and key, and the latest values of each measurement."""

    def __init__(self) -> None:
        self.now = 0.0
        self._last: dict[str, dict[int | str, Any]] = {}
        self._values: dict[int | str, deque[float]] = {}

    def put(self, row: Any) -> None:  # noqa: ANN401  # a row, of Python or of JSON
        time, track, key, value = row
        self.now = max(self.now, time)
        last = self._last.setdefault(track, {})
        if track in _LOGGED and value is not None:
            value = {"t": time, **(value if isinstance(value, dict) else {"words": value})}
        last[key] = value
        if track in NUMBERED and len(last) > _KEPT:
            del last[next(iter(last))]
        if track in ("value", "signal") and value is not None:
            self._values.setdefault(key, deque(maxlen=_KEPT)).append(float(value))

    def track(self, name: str) -> Mapping[int | str, Any]:
        return self._last.get(name, {})

    def tree(self) -> Iterator[Text]:
        """Yield a line for each behaviour: status, name, feedback."""
        for tree in self.track("tree").values():
            depths: dict[int, int] = {}
            for uid, parent, _, name, _, _ in tree["nodes"]:
                depths[uid] = depths.get(parent, -1) + 1
                status, feedback = self.track("node").get(uid) or ("", "")
                line = Text("  " * depths[uid]) + _signed(status.upper(), name)
                yield line.append(f"  {feedback}", "dim") if feedback else line

    def known(self) -> Iterator[Text]:
        """Yield actions, functions and components with status, selection and reason."""
        status = self.track("status")
        elements = self.track("element")
        for kind, chosen_by in (
            ("action", ""),
            ("function", "designs"),
            ("component", "configurations"),
        ):
            yield Text(f"{kind}s", "bold")
            for key, element in elements.items():
                if element is None or element["kind"] != kind:
                    continue
                line = _signed(str(status.get(key, "")), element["name"])
                if self.track("required").get(key):
                    line.append(" required", "bold")
                if self.track("active").get(key):
                    line.append(" runs", "blue")
                chosen = [
                    elements[part]["name"]
                    for part in element.get(chosen_by) or ()
                    if self.track("selected").get(part)
                ]
                line.append(f" {', '.join(chosen)}" if chosen else "", "cyan")
                why = (
                    self.track("why").get(key)
                    if status.get(key) in ("unfeasible", "failure")
                    else ""
                )
                yield line.append(f"  {why}", "dim") if why else line

    def adaptations(self) -> Iterator[Text]:
        """Yield the adaptations, the latest first: time, change and cause."""
        for adaptation in reversed(list(self.track("adaptation").values())):
            line = Text(f"{adaptation['t']:7.1f} s  ", "dim")
            line.append(str(adaptation["changed"]), "bold")
            yield line.append(f"\n{'':11}{adaptation['cause']}", "dim")

    def log(self, words: str) -> Iterator[Text]:
        """Yield what happened, the latest first: time, level and text.

        Only what has the words, if any are given.
        """
        entries = []
        for track, level in _LOGGED.items():
            for entry in self.track(track).values():
                text = str(entry.get("words", ""))
                if track == "taskplan":
                    text = f"plan: {entry['outcome']} ({entry['engine']}), {entry['reason']}"
                entries.append((entry["t"], entry.get("level", level), text))
        for time, level, text in sorted(entries, reverse=True):
            if all(word in f"{level} {text}".casefold() for word in words.casefold().split()):
                line = Text(f"{time:7.1f} s  ", "dim")
                yield line.append(f"{level:<8}", _LEVELS[level]).append(text)

    def measurements(self, width: int) -> Iterator[Text]:
        """Yield each measurement with its latest value, and a line of its latest values."""
        elements = self.track("element")
        for key, values in self._values.items():
            name, unit = (
                (elements[key]["name"], elements[key]["unit"])
                if key in elements
                else (str(key), "")
            )
            stale = " stale" if self.track("stale").get(key) else ""
            yield Text(f"{name[:20]:<20} {values[-1]:>8.4g} {unit}", "bold").append(stale, "red")
            yield Text(_course(values, max(10, width)), "blue")


def _signed(status: str, text: str) -> Text:
    sign, style = _STYLES.get(status, ("!", "yellow") if status else ("·", "dim"))
    return Text(f"{sign} ", style) + Text(text)


def _course(values: deque[float], width: int) -> str:
    shown = list(values)[-width:]
    low = min(shown)
    high = max(shown)
    step = (high - low) / (len(_SPARKS) - 1) or 1.0
    return "".join(_SPARKS[int((value - low) / step)] for value in shown)


class TerminalView(App[None]):
    """Shows the rows of a recorder until the user leaves with `q`.

    Args:
        steering: pauses the run and has it go on; None for a run that can only be watched.
    """

    CSS = """
    Screen { layout: grid; grid-size: 2 2; }
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
    PANES: Final = ("tree", "known", "adaptations", "measurements", "log")

    def __init__(self, recorder: Recorder, steering: Steering | None = None) -> None:
        super().__init__()
        self.title = str(recorder.header.get("title", ""))
        self._rows = recorder.rows
        self._next = 0
        self._steering = steering
        self._fold = Fold()
        self._shown = {name: Static(id=name) for name in self.PANES}
        self._filter = Input(placeholder="words that an entry must have", classes="hidden")

    def compose(self) -> ComposeResult:
        yield Header()
        for name, shown in self._shown.items():
            pane = VerticalScroll(shown, classes="hidden" if name == "log" else "")
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
        first, rows = self._rows.since(self._next)
        self._next = first + len(rows)
        for row in rows:
            self._fold.put(row)
        ended = self._fold.track("result").get(0)
        words = [f"{self._fold.now:.1f} s"]
        if ended:
            words.append(f"{ended['outcome']}: {ended['reason']}")
        elif self._steering is not None and self._steering.state["paused"]:
            words.append(f"paused {self._steering.state['stopped']}".strip())
        self.sub_title = "  ".join(words)
        lines = {
            "tree": self._fold.tree(),
            "known": self._fold.known(),
            "adaptations": self._fold.adaptations(),
            "measurements": self._fold.measurements(self.size.width // 2 - 6),
            "log": self._fold.log(self._filter.value),
        }
        for name, shown in lines.items():
            self._shown[name].update(Text("\n").join(shown))
