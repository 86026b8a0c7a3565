"""Breakpoints: conditions on what a page shows, at which a run or a replay stops.

inspect_pipeline unfeasible      an element has a status
battery_level < 0.25             a measurement crosses a value
"follow pipeline" success        a behaviour of the tree ends its tick with a status
"""

import operator
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, Final

from kb import KnowledgeBaseError, Model, Status, UnknownName
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
_STATUSES: Final = sorted([*map(str, Status), *_LETTERS, *_SAME], key=len, reverse=True)
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
        self._conditions: dict[str, Callable[[Any], bool]]  # on values, by track
        self._holds: dict[tuple[str, int | str], bool] = {}
        comparison = re.fullmatch(r"\s*(.+?)\s*(<=|>=|<|>)\s*(\S+)\s*", text)
        if comparison is not None:
            self.name, sign, number = comparison.groups()
            try:
                limit = float(number)
            except ValueError:
                raise MissionError(f"{number!r} in breakpoint {text!r} is no number") from None
            compare = _COMPARISONS[sign]
            self._conditions = {"value": lambda value: compare(value, limit)}
            return
        words = text.strip()
        ending = next((status for status in _STATUSES if words.endswith(f" {status}")), "")
        name = words.removesuffix(ending).strip()
        self.name = name.removesuffix(" has").removesuffix(" is").strip(" '\"")
        if not ending or not self.name:
            raise MissionError(f"{text!r} is no breakpoint; {_FORM}")
        status = _SAME.get(ending, ending)
        letter = _LETTERS.get(status)
        self._conditions = {
            "status": lambda value: bool(value == status),
            "node": lambda value: bool(value[0] == letter),
        }

    def check(self, model: Model, behaviours: Iterable[str]) -> None:
        """Raise UnknownName with the nearest names if nothing has this name."""
        kind = "attribute"
        names = [*model.attributes]
        if "value" not in self._conditions:
            kind = "element or behaviour"
            names = [*model.actions, *model.functions, *model.designs, *behaviours]
            names += [*model.components, *model.configurations]
        if self.name not in names:
            raise UnknownName(kind, self.name, names)

    def is_met(self, track: str, key: int | str, name: str, value: Any) -> bool:  # noqa: ANN401  # what a row shows
        """Return whether a row of a page makes the condition hold, which did not hold before."""
        if name != self.name or value is None or track not in self._conditions:
            return False
        before = self._holds.get((track, key), False)
        self._holds[track, key] = self._conditions[track](value)
        return self._holds[track, key] and not before


class Breakpoints:
    """Watches the rows of a run for breakpoints, and calls a function for each that is met."""

    def __init__(self, run: MissionRun, met: Callable[[Breakpoint, float], object]) -> None:
        self._run = run
        self._met = met
        self._all: list[Breakpoint] = []
        self._names: dict[int | str, str] = {}  # of elements and behaviours

    @property
    def texts(self) -> list[str]:
        return [breakpoint.text for breakpoint in self._all]

    def set(self, texts: Iterable[str]) -> None:
        """Replace the breakpoints.

        Raises:
            MissionError, UnknownName: one has no meaning, or nothing has its name.
        """
        tree = self._run.tree
        behaviours = [] if tree is None else [node.name for node in tree.root.iterate()]
        breakpoints = [Breakpoint(text) for text in texts]
        for breakpoint in breakpoints:
            breakpoint.check(self._run.model, behaviours)
        self._all = breakpoints

    def watch(self, rows: Rows) -> None:
        """Hear the rows from now on; what holds already meets no breakpoint."""
        for row in rows.snapshot()[0]:
            self._hear(row)
        rows.listeners.append(self._hear)

    def _hear(self, row: Row) -> None:
        time, track, key, value = row
        if track == "element" and value is not None:
            self._names[key] = value["name"]
        elif track == "tree":
            self._names |= {uid: name for uid, _, _, name, _, _ in value["nodes"]}
        for breakpoint in self._all:
            if breakpoint.is_met(track, key, self._names.get(key, ""), value):
                self._met(breakpoint, time)


def watch_breakpoints(run: MissionRun, rows: Rows, texts: Iterable[str]) -> None:
    """End a run at the first breakpoint that is met, with the explanation of its element."""

    def end(breakpoint: Breakpoint, time_s: float) -> None:
        explained = ""
        with suppress(MissionError, KnowledgeBaseError):  # a behaviour, or a run without a base
            explained = str(run.kb.explain(breakpoint.name))
        words = f"stopped at breakpoint {breakpoint.text!r} after {time_s:.1f} s"
        run.early_verdict = Verdict("aborted", words, explained)

    breakpoints = Breakpoints(run, end)
    breakpoints.watch(rows)
    breakpoints.set(texts)
