"""Pictures of a tree with what can be done, and why not, drawn in: as text, for Graphviz, and as SVG.

A picture shows the last tick, and for each action what the knowledge base says of it at this moment.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from textwrap import wrap
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Parallel, Selector
from py_trees.composites import Sequence as SequenceNode
from py_trees.decorators import Decorator

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction
from rosa_bt.exceptions import in_words

_MARKS: Final = {Status.SUCCESS: "o", Status.FAILURE: "x", Status.RUNNING: "*", Status.INVALID: "-"}
_FILLS: Final = {
    **{Status.SUCCESS: "#d5ecd4", Status.FAILURE: "#f6d0cb"},
    **{Status.RUNNING: "#cfe0f5", Status.INVALID: "#f2f2f2"},
}
_SIGNS: Final = {
    **{SequenceNode: "->", SafeSwitch: "->", Selector: "?", DoUntilUnfeasible: "?!"},
    **{Parallel: "=>", Decorator: "^"},
}
_FEASIBLE, _UNFEASIBLE, _PLAIN = "#2e7d32", "#c62828", "#8a8a8a"
_WIDTH: Final = 44  # after how many characters a line of a note is broken


@dataclass(frozen=True, slots=True)
class _Drawn:
    """What is drawn of a behaviour."""

    title: str
    """Its status, what it is (e.g. "->" for a sequence) and its name."""
    status: Status
    edge: str
    """The colour says whether its action is feasible."""
    notes: tuple[str, ...]
    """Feasibility with the reason, and feedback that says something else."""
    children: tuple["_Drawn", ...]


def ascii_tree(root: Behaviour) -> str:
    """Return a tree as text: one line for each behaviour, with its status, feasibility and feedback.

    `*` is RUNNING, `o` SUCCESS, `x` FAILURE, `-` not ticked; `->` is a sequence, `?` a selector, `=>` a parallel, `^` a
    decorator, `?!` a task that gives way; an `m` is for memory.
    """
    return "".join(f"{line}\n" for line in _lines(_drawn(root), "", ""))


def dot_tree(root: Behaviour) -> str:
    """Return a tree as a graph for Graphviz: `dot -Tsvg` draws it."""
    lines = ["digraph tree {", "  rankdir=LR;", '  node [shape=box, style="rounded,filled", fontname="sans-serif"];']
    pending, number = [(_drawn(root), -1)], 0
    while pending:
        drawn, parent = pending.pop(0)
        label = "\\n".join(line.replace("\\", "\\\\").replace('"', '\\"') for line in _text(drawn))
        lines.append(f'  n{number} [label="{label}", fillcolor="{_FILLS[drawn.status]}", color="{drawn.edge}"];')
        if parent >= 0:
            lines.append(f"  n{parent} -> n{number};")
        pending += [(child, number) for child in drawn.children]
        number += 1
    return "\n".join([*lines, "}", ""])


def svg_tree(root: Behaviour) -> str:
    """Return a tree as an SVG picture of its own: root at the left, one column for each depth."""
    drawn = _drawn(root)
    picture = _Svg(drawn)
    _, height = picture.place(drawn, 0, _GAP)
    size = f'width="{picture.starts[-1] - _COLUMN_GAP + _GAP:g}" height="{height:g}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} {FONT}>'
    return "\n".join([head, f'<rect {size} fill="white"/>', *picture.edges, *picture.shapes, "</svg>", ""])


def _drawn(behaviour: Behaviour, said: set[str] | None = None, *, is_idle: bool = False) -> _Drawn:
    """Return what is drawn of a behaviour and of all below it; a reason that stands above is not repeated.

    What has finished below a node that was reset since then is drawn as not ticked.
    """
    said = set() if said is None else said
    status = Status.INVALID if is_idle and behaviour.status is not Status.RUNNING else behaviour.status
    reason = _feasibility(behaviour)
    is_said = reason in said
    said.add(reason)
    feasibility = "unfeasible" if is_said and reason != "feasible" and reason else reason
    feedback = _plain(behaviour.feedback_message)
    notes = [feasibility, feedback] if feedback not in said and not reason.endswith(feedback) else [feasibility]
    edge = _PLAIN if not feasibility else _FEASIBLE if feasibility == "feasible" else _UNFEASIBLE
    title = " ".join(filter(None, [f"[{_MARKS[status]}]", _kind(behaviour), _plain(behaviour.name)]))
    below = tuple(_drawn(child, said, is_idle=status is Status.INVALID) for child in behaviour.children)
    return _Drawn(title, status, edge, tuple(filter(None, notes)), below)


def _plain(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in " ".join(text.split()))


def _feasibility(behaviour: Behaviour) -> str:
    """Return what the knowledge base says of the behaviour's action; empty if it has none."""
    if not isinstance(behaviour, ActionBehaviour | ForAction):
        return ""
    try:
        kb, action = behaviour.kb, behaviour.action
        return "feasible" if kb.is_feasible(action) else kb.why(kb.actions[action])
    except Exception as error:  # a port that nobody has written yet, or that carries no action's name
        return f"action not known yet: {_plain(in_words(error))}"


def _kind(behaviour: Behaviour) -> str:
    for kind, sign in _SIGNS.items():
        if isinstance(behaviour, kind):
            return f"{sign}m" if getattr(behaviour, "memory", False) else sign
    return "+" if behaviour.children else ""


def _lines(drawn: _Drawn, lead: str, below: str) -> Iterator[str]:
    notes = f"  ({'; '.join(drawn.notes)})" if drawn.notes else ""
    yield f"{lead}{drawn.title}{notes}"
    for child in drawn.children:
        is_last = child is drawn.children[-1]
        yield from _lines(child, below + ("`-- " if is_last else "|-- "), below + ("    " if is_last else "|   "))


def _text(drawn: _Drawn) -> list[str]:
    return [drawn.title, *(line for note in drawn.notes for line in wrap(note, _WIDTH))]


FONT: Final = 'font-family="sans-serif" font-size="12"'
_GAP: Final = 12.0
_COLUMN_GAP: Final = 40.0
LINE: Final = 16.0
LETTER: Final = 6.9
"""Sizes in pixels; a letter is as wide as it is on average, with something to spare."""


class _Svg:
    """Places behaviours in pixels from the upper left corner: children below one another at the right of their parent.

    A column for each depth begins at one of `starts`; the last one is where one more would.
    """

    def __init__(self, root: _Drawn) -> None:
        self.starts = [_GAP]
        self.edges: list[str] = []
        self.shapes: list[str] = []
        column = [root]
        while column:
            self.starts.append(self.starts[-1] + max(_size(one)[0] for one in column) + _COLUMN_GAP)
            column = [child for one in column for child in one.children]

    def place(self, drawn: _Drawn, depth: int, top: float) -> tuple[float, float]:
        """Draw a subtree that may begin at a height; return the middle of its root, and where the next may begin."""
        x, (width, height) = self.starts[depth], _size(drawn)
        middles: list[float] = []
        bottom = top
        for child in drawn.children:
            middle, bottom = self.place(child, depth + 1, bottom)
            middles.append(middle)
        y = max(top, (middles[0] + middles[-1] - height) / 2) if middles else top
        for middle in middles:
            bend = f"M{x + width:g} {y + height / 2:g}H{self.starts[depth + 1] - _COLUMN_GAP / 2:g}V{middle:g}"
            self.edges.append(f'<path d="{bend}H{self.starts[depth + 1]:g}" fill="none" stroke="{_PLAIN}"/>')
        edge = f'stroke="{drawn.edge}" stroke-width="{1 if drawn.edge == _PLAIN else 2}"'
        self.shapes += svg_box(x, y, _text(drawn), f'fill="{_FILLS[drawn.status]}" {edge}')
        return y + height / 2, max(bottom, y + height + _GAP)


def _size(drawn: _Drawn) -> tuple[float, float]:
    return svg_size(_text(drawn))


def svg_size(lines: Sequence[str]) -> tuple[float, float]:
    """Return width and height of a box with lines of text [px]; the first is in bold letters."""
    longest = max(len(line) * (1.1 if line is lines[0] else 1.0) for line in lines)
    return 16 + LETTER * longest, 10 + LINE * len(lines)


def svg_box(x: float, y: float, lines: Sequence[str], style: str) -> Iterator[str]:
    """Yield the elements of a box with lines of text, its upper left corner at (x, y) [px]."""
    width, height = svg_size(lines)
    yield f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5" {style}/>'
    for number, line in enumerate(lines):
        weight = 'font-weight="bold"' if number == 0 else 'fill="#444444"'
        yield f'<text x="{x + 8:g}" y="{y + 17 + number * LINE:g}" {weight}>{escape(line)}</text>'
