"""Pictures of a tree, with the feasibility of its actions: as text, and as SVG.

A picture shows the statuses after the last tick, and for each action what the knowledge base says
now.
"""

from collections.abc import Iterator, Sequence
from html import escape
from textwrap import wrap
from typing import NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Parallel, Selector
from py_trees.composites import Sequence as SequenceNode
from py_trees.decorators import Decorator

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction
from rosa_bt.exceptions import in_words
from rosa_bt.requests import FAILURE, INVALID, RUNNING, SUCCESS

_MARKS = {SUCCESS: "o", FAILURE: "x", RUNNING: "*", INVALID: "-"}
_FILLS = {
    **{SUCCESS: "#d5ecd4", FAILURE: "#f6d0cb"},
    **{RUNNING: "#cfe0f5", INVALID: "#f2f2f2"},
}
_SIGNS = {
    **{SequenceNode: "->", SafeSwitch: "->", Selector: "?", DoUntilUnfeasible: "?!"},
    **{Parallel: "=>", Decorator: "^"},
}
_FEASIBLE, _UNFEASIBLE, _PLAIN = "#2e7d32", "#c62828", "#8a8a8a"
_WIDTH = 44  # characters in a line of a note; longer notes are wrapped


class _Row(NamedTuple):
    """What is drawn for one behaviour; rows are in order, parents before children."""

    parent: int  # number of the parent's row; -1 for the root
    lead: str  # the lines before it in a text, four characters for each level
    title: str  # status, kind (e.g. "->" for a sequence) and name
    status: Status
    edge: str  # colour of the border: whether the action is feasible
    notes: tuple[str, ...]  # feasibility with the reason, and feedback, if it says something else

    @property
    def lines(self) -> list[str]:
        return [self.title, *(line for note in self.notes for line in wrap(note, _WIDTH))]


def ascii_tree(root: Behaviour) -> str:
    """Return a tree as text, a line for each behaviour with status, feasibility and feedback.

    `*` is RUNNING, `o` SUCCESS, `x` FAILURE, `-` not ticked. `->` is a sequence, `?` a selector,
    `=>` a parallel, `^` a decorator, `?!` a `DoUntilUnfeasible`; `m` stands for memory.
    """
    lines = []
    for row in _rows(root):
        notes = f"  ({'; '.join(row.notes)})" if row.notes else ""
        lines.append(f"{row.lead}{row.title}{notes}\n")
    return "".join(lines)


def svg_tree(root: Behaviour) -> str:
    """Return a tree as an SVG picture, one behaviour below the other, children indented."""
    edges = list[str]()
    shapes = list[str]()
    feet = list[tuple[float, float]]()
    right = 0.0
    top = _GAP
    for row in _rows(root):
        left = _GAP + len(row.lead) * _GAP / 2
        width, height = svg_size(row.lines)
        if row.parent >= 0:
            x, y = feet[row.parent]
            bend = f"M{x:g} {y:g}V{top + height / 2:g}H{left:g}"
            edges.append(f'<path d="{bend}" fill="none" stroke="{_PLAIN}"/>')
        edge = f'stroke="{row.edge}" stroke-width="{1 if row.edge == _PLAIN else 2}"'
        shapes += svg_box(left, top, row.lines, f'fill="{_FILLS[row.status]}" {edge}')
        feet.append((left + _GAP, top + height))
        right = max(right, left + width + _GAP)
        top = top + height + _GAP
    size = f'width="{right:g}" height="{top:g}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} {FONT}>'
    return "\n".join([head, f'<rect {size} fill="white"/>', *edges, *shapes, "</svg>", ""])


def _rows(root: Behaviour) -> list[_Row]:
    """Return the rows, parents before children; a reason that an earlier row gives is not repeated.

    A finished behaviour below a node that has been reset is drawn as not ticked.
    """
    rows = list[_Row]()
    said = set[str]()
    pending = [(root, -1, "", "", False)]
    while pending:
        behaviour, parent, lead, below, is_idle = pending.pop()
        status = INVALID if is_idle and behaviour.status is not RUNNING else behaviour.status
        reason = _feasibility(behaviour)
        feasibility = reason
        if reason in said and reason not in ("", "feasible"):
            feasibility = "unfeasible"
        said.add(reason)
        notes = [feasibility]
        feedback = _plain(behaviour.feedback_message)
        if feedback not in said and not reason.endswith(feedback):
            notes.append(feedback)
        edge = {"": _PLAIN, "feasible": _FEASIBLE}.get(feasibility, _UNFEASIBLE)
        title = [f"[{_MARKS[status]}]", _kind(behaviour), _plain(behaviour.name)]
        for child in reversed(behaviour.children):
            step, rest = ("`-- ", "    ") if child is behaviour.children[-1] else ("|-- ", "|   ")
            pending.append((child, len(rows), below + step, below + rest, status is INVALID))
        row = " ".join(filter(None, title)), status, edge, tuple(filter(None, notes))
        rows.append(_Row(parent, lead, *row))
    return rows


def _plain(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))


def _feasibility(behaviour: Behaviour) -> str:
    """Return "feasible", or why the behaviour's action is not; empty if it has no action."""
    if not isinstance(behaviour, ActionBehaviour | ForAction):
        return ""
    try:
        kb = behaviour.kb
        action = behaviour.action
        return "feasible" if kb.is_feasible(action) else kb.why(kb.actions[action])
    except Exception as error:  # the port is not written yet, or holds no name of an action
        return f"action not known yet: {_plain(in_words(error))}"


def _kind(behaviour: Behaviour) -> str:
    for kind, sign in _SIGNS.items():
        if isinstance(behaviour, kind):
            return f"{sign}m" if getattr(behaviour, "memory", False) else sign
    return "+" if behaviour.children else ""


FONT = 'font-family="sans-serif" font-size="12"'
_GAP = 12.0
LINE = 16.0
LETTER = 6.9
"""Sizes [px]; LETTER is a little more than the average width of a character."""


def svg_size(lines: Sequence[str]) -> tuple[float, float]:
    """Return width and height of a box with lines of text [px]; the first line is bold."""
    longest = max(len(line) * (1.1 if line is lines[0] else 1.0) for line in lines)
    return 16 + LETTER * longest, 10 + LINE * len(lines)


def svg_box(x: float, y: float, lines: Sequence[str], style: str) -> Iterator[str]:
    """Yield the SVG elements of a box with lines of text; (x, y) is its upper left corner [px]."""
    width, height = svg_size(lines)
    yield f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5" {style}/>'
    for number, line in enumerate(lines):
        weight = 'font-weight="bold"' if number == 0 else 'fill="#444444"'
        yield f'<text x="{x + 8:g}" y="{y + 17 + number * LINE:g}" {weight}>{escape(line)}</text>'
