"""Breakpoints: conditions on what a page shows, at which a run or a replay stops.

inspect_pipeline unfeasible      an element has a status battery_level < 0.25             a
measurement crosses a value "follow pipeline" success        a behaviour of the tree ends its tick
with a status
"""

import operator
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from difflib import get_close_matches
from typing import Any, Final

from kb import KnowledgeBaseError, Model, Status
from missions.engine.mission import MissionError, Verdict
from missions.engine.runner import MissionRun
from missions.views.report import Row, Rows

_COMPARISONS: Final[dict[str, Callable[[float, float], bool]]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}
_LETTERS: Final = {"running": "R", "success": "S", "failure": "F"}
_SAME: Final = {"failed": "failure"}
_STATUSES: Final = sorted([*map(str, Status), "running", "success", *_SAME], key=len, reverse=True)
_FORM: Final = (
    "write ELEMENT STATUS, ATTRIBUTE < VALUE or BEHAVIOUR STATUS, "
    'such as "inspect_pipeline unfeasible" or "battery_level < 0.25"'
)


class Breakpoint:
    """One condition; it is met when it begins to hold.

    Args:
        text: such as "inspect_pipeline unfeasible", "battery_level < 0.25" or "'follow pipeline'
            success".

    Raises:
        MissionError: the text is no condition; the message shows the forms.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        comparison = re.fullmatch(r"\s*(.+?)\s*(<=|>=|<|>)\s*(\S+)\s*", text)
        self._compare: Callable[[float, float], bool] | None = None
        self._holds: dict[int | str, bool] = {}
        if comparison is not None:
            self.name, sign, number = comparison.groups()
            self._compare = _COMPARISONS[sign]
            try:
                self._value = float(number)
            except ValueError:
                raise MissionError(f"{number!r} in breakpoint {text!r} is no number") from None
            return
        words = text.strip()
        self.status = next((status for status in _STATUSES if words.endswith(f" {status}")), "")
        name = words.removesuffix(self.status).strip()
        self.name = name.removesuffix(" has").removesuffix(" is").strip(" '\"")
        self.status = _SAME.get(self.status, self.status)
        if not self.status or not self.name:
            raise MissionError(f"{text!r} is no breakpoint; {_FORM}")

    def check(self, model: Model, behaviours: Iterable[str]) -> None:
        """Raise a MissionError with the nearest names if nothing has this name."""
        names = list(model.attributes)
        if self._compare is None:
            elements = [model.actions, model.functions, model.designs]
            elements += [model.components, model.configurations]
            names = [name for mapping in elements for name in mapping] + list(behaviours)
        if self.name in names:
            return
        close = get_close_matches(self.name, names, n=3)
        advice = f"; did you mean {' or '.join(close)}?" if close else ""
        raise MissionError(f"breakpoint {self.text!r}: nothing is named {self.name!r}{advice}")

    def is_met(self, track: str, key: int | str, name: str, value: Any) -> bool:  # noqa: ANN401  # what a row shows
        """Return whether a row of a page makes the condition hold, which did not hold before."""
        if name != self.name or value is None:
            return False
        if self._compare is not None:
            if track != "value":
                return False
            holds = self._compare(value, self._value)
        elif track == "status":
            holds = value == self.status
        elif track == "node":
            holds = value[0] == _LETTERS.get(self.status)
        else:
            return False
        before = self._holds.get(f"{track} {key}", False)
        self._holds[f"{track} {key}"] = holds
        return holds and not before


class Breakpoints:
    """Watches the rows of a page for breakpoints, and calls a function for each that is met."""

    def __init__(self, met: Callable[[Breakpoint, float], object]) -> None:
        self.all: list[Breakpoint] = []
        self._met = met
        self._names: dict[tuple[str, int | str], str] = {}

    def watch(self, rows: Rows) -> None:
        """Hear the rows from now on; what holds already meets no breakpoint."""
        if self.hear in rows.listeners:
            return
        latest, _ = rows.snapshot()
        for row in latest:
            self.hear(row)
        rows.listeners.append(self.hear)

    def hear(self, row: Row) -> None:
        """Take in a row: (time, track, key, value)."""
        time, track, key, value = row
        if track == "element" and value is not None:
            self._names["element", key] = value["name"]
        elif track == "tree":
            for uid, _, _, name, _, _ in value["nodes"]:
                self._names["node", uid] = name
        elif track in ("status", "value", "node"):
            kind = "node" if track == "node" else "element"
            name = self._names.get((kind, key), "")
            for breakpoint in self.all:
                if breakpoint.is_met(track, key, name, value):
                    self._met(breakpoint, time)


def read_breakpoints(run: MissionRun, texts: Iterable[str]) -> list[Breakpoint]:
    """Return breakpoints of a run; MissionError if one has no meaning, or nothing has its name."""
    behaviours = [] if run.tree is None else [node.name for node in run.tree.root.iterate()]
    breakpoints = [Breakpoint(text) for text in texts]
    for breakpoint in breakpoints:
        breakpoint.check(run.model, behaviours)
    return breakpoints


def watch_breakpoints(run: MissionRun, rows: Rows, texts: Iterable[str]) -> None:
    """End a run at the first breakpoint that is met, with the explanation of its element."""

    def end(breakpoint: Breakpoint, time_s: float) -> None:
        explained = ""
        with suppress(MissionError, KnowledgeBaseError):  # a behaviour, or a run without a base
            explained = str(run.kb.explain(breakpoint.name))
        words = f"stopped at breakpoint {breakpoint.text!r} after {time_s:.1f} s"
        run.early_verdict = Verdict("aborted", words, explained)

    breakpoints = Breakpoints(end)
    breakpoints.all = read_breakpoints(run, texts)
    breakpoints.watch(rows)
