"""A plan as people see it: its steps with what they need, and a picture of their causal order.

The picture goes from the top to the goal; side by side is what could come in any order.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from textwrap import wrap
from typing import Final, NamedTuple

from missions.engine.question import Answer
from rosa_bt.display import FONT, LETTER, LINE, svg_box, svg_size
from rosa_pddl import Certificate, Domain, PlanningResult, State, Step
from rosa_pddl.domain import UpThing
from rosa_pddl.validate import binding_of, ended, mentioned_atoms, started

_LETTERS: Final = 38
"""After how many characters a line in a box is broken."""
_GAP, _ROW_GAP, _LANE = 24.0, 46.0, 16.0
"""Sizes in pixels."""
_MARKER: Final = (
    '<defs><marker id="{}" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="{}"/></marker></defs>'
)
_LEGEND: Final = "dashed: earlier, it would spoil what the other step needs"
_EDGE, _LATER = "#46627f", "#b06a00"
_STEP, _GOAL = (f'fill="{fill}" stroke="{_EDGE}"' for fill in ("#eef3f8", "#d5ecd4"))


class Link(NamedTuple):
    """A step, by its number from 0, makes so what another one, or the goal after the last, needs: (negated) atoms."""

    source: int
    target: int
    needs: tuple[str, ...]


class CausalOrder(NamedTuple):
    """Why the steps of a plan come in their order; what it leaves open could come the other way round."""

    steps: tuple[Step, ...]
    links: tuple[Link, ...]
    orders: tuple[tuple[int, int], ...]
    """(earlier, later) where the later step would spoil what the earlier one needs or does, if no links say so."""


def lines_of(answer: Answer) -> Iterator[str]:
    """Yield a plan, a line for each step with the steps that it needs, or why there is none."""
    question, result = answer.question, answer.result
    if not result.outcome.is_solved:
        yield f"no plan: {result.message or result.outcome}"
        yield from (f"  {obstacle}" for obstacle in answer.obstacles)
    else:
        steps = "1 step" if len(result.steps) == 1 else f"{len(result.steps)} steps"
        yield f"{result.outcome} by {result.engine}: {steps}, cost {result.cost or 0:g}"
        links = causes_of(answer).links
        for number, step in enumerate(result.steps):
            needs = [f"{' '.join(link.needs)} by {link.source + 1}" for link in links if link.target == number]
            yield f"  {number + 1}  {step}" + (f"  needs {', '.join(needs)}" if needs else "")
    yield from (f"out: {question.kb.why(question.kb.actions[action])}" for action in question.unfeasible)
    yield from (f"note: {oversight}" for oversight in question.oversights)


def as_data(result: PlanningResult) -> dict[str, object]:
    steps = [{"action": step.schema, "arguments": list(step.arguments)} for step in result.steps]
    return {"outcome": str(result.outcome), "engine": result.engine, "cost": result.cost, "steps": steps}


def certificate_lines(certificate: Certificate) -> Iterator[str]:
    """Yield a table of what to do for each combination of unfeasible actions, and which failures end the mission."""
    rows = [("unfeasible", "cost", "plan")]
    for out, result in certificate.entries.items():
        plan = ", ".join(map(str, result.steps)) or "nothing is left to do"
        cost = "" if result.cost is None else f"{result.cost:g}"
        found = plan if result.outcome.is_solved else f"no plan: {result.outcome}"
        rows.append((", ".join(out) or "none", cost, found))
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    yield from (f"{out:<{widths[0]}}  {cost:>{widths[1]}}  {plan}" for out, cost, plan in rows)
    yield f"single failures that end the mission: {', '.join(certificate.fatal) or 'none'}"


def certificate_as_data(certificate: Certificate) -> dict[str, object]:
    entries = [{"unfeasible": list(out), **as_data(result)} for out, result in certificate.entries.items()]
    return {"fatal": list(certificate.fatal), "entries": entries}


def causes_of(answer: Answer) -> CausalOrder:
    question = answer.question
    goals = [goal.expression for goal in question.goals]
    return causal_order(question.domain, answer.result.steps, question.state, goals)


def causal_order(domain: Domain, steps: Sequence[Step], state: State, goals: Iterable[UpThing]) -> CausalOrder:
    """Return why the steps of a plan, from a state to the goals, come in their order."""
    changer: dict[str, int] = {}
    touched: defaultdict[str, set[int]] = defaultdict(set)
    links: list[Link] = []
    threats: set[tuple[int, int]] = set()
    for number in range(len(steps) + 1):
        if number < len(steps):
            needed, changed, after = _replayed(domain, steps[number], state)
        else:
            needed, changed, after = set(mentioned_atoms(domain, goals, (), {})), frozenset(), state
        causes: defaultdict[int, list[str]] = defaultdict(list)
        for atom in sorted(needed & changer.keys()):
            causes[changer[atom]].append(atom if atom in state else f"(not {atom})")
        links += [Link(source, number, tuple(atoms)) for source, atoms in sorted(causes.items())]
        threats |= {(earlier, number) for atom in changed for earlier in touched[atom]}
        changer |= dict.fromkeys(changed, number)
        for atom in needed | changed:
            touched[atom].add(number)
        state = after
    return CausalOrder(tuple(steps), tuple(links), _beyond(links, threats, len(steps) + 1))


def _replayed(domain: Domain, step: Step, state: State) -> tuple[set[str], State, State]:
    """Return what a step looks at, what it changes, and the state after it."""
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    needed = set(mentioned_atoms(domain, schema.start, schema.start_effects, binding))
    meanwhile = started(domain, step, state)
    changed = state ^ meanwhile
    needed |= set(mentioned_atoms(domain, schema.over_all + schema.end, schema.end_effects, binding)) - changed
    after = ended(domain, step, meanwhile)
    return needed, changed | (meanwhile ^ after), after


def _beyond(links: Iterable[Link], threats: Iterable[tuple[int, int]], count: int) -> tuple[tuple[int, int], ...]:
    """Return the orders that no chain of links and other orders says already."""
    linked = {(link.source, link.target) for link in links}
    before: list[set[int]] = [set() for _ in range(count)]
    orders: list[tuple[int, int]] = []
    for later in range(count):
        for source in {source for source, target in linked if target == later}:
            before[later] |= {source, *before[source]}
        # the latest first: what comes before it is then said already
        for earlier in sorted((one for one, other in threats if other == later), reverse=True):
            if earlier not in before[later]:
                orders.append((earlier, later))
                before[later] |= {earlier, *before[earlier]}
    return tuple(sorted(orders))


def svg_of(order: CausalOrder, title: str) -> str:
    """Draw a plan: an arrow for what one step makes so and another one needs, a dashed one for what must wait."""
    boxes = _boxes(order)
    arrows = [(link.source, link.target, False) for link in order.links]
    arrows += [(earlier, later, True) for earlier, later in order.orders]
    rows: list[list[_Box]] = [[] for _ in range(max(box.row for box in boxes) + 1)]
    for box in boxes:
        rows[box.row].append(box)
    paths = [(_path(boxes[source], boxes[target], rows), later) for source, target, later in arrows]
    width, height = _place(rows)
    height += LINE if order.orders else 0.0
    width = max(width, 2 * _GAP + LETTER * max(1.1 * len(title), len(_LEGEND) if order.orders else 0))
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" {FONT}>',
            f"<title>{escape(title)}</title>",
            *(_MARKER.format(name, colour) for name, colour in (("so", _EDGE), ("wait", _LATER))),
            f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
            f'<text x="{_GAP:g}" y="{_GAP:g}" font-weight="bold">{escape(title)}</text>',
            *(_arrow(path, later) for path, later in paths),
            *(line for box in boxes for line in svg_box(box.x, box.y, box.lines, _GOAL if box.is_goal else _STEP)),
            *([f'<text x="{_GAP:g}" y="{height - 8:g}" fill="{_LATER}">{_LEGEND}</text>'] if order.orders else []),
            "</svg>",
            "",
        ]
    )


@dataclass
class _Box:
    """A step, the goal, or, without lines, a place where an arrow passes a row, as tall as that."""

    row: int
    lines: tuple[str, ...] = ()
    is_goal: bool = False
    above: list["_Box"] = field(default_factory=list)
    x: float = 0.0
    y: float = 0.0
    passed: float = 0.0

    @property
    def width(self) -> float:
        return svg_size(self.lines)[0] if self.lines else _LANE

    @property
    def height(self) -> float:
        return svg_size(self.lines)[1] if self.lines else self.passed

    @property
    def middle(self) -> float:
        return self.x + self.width / 2


def _boxes(order: CausalOrder) -> list[_Box]:
    goal = len(order.steps)
    boxes: list[_Box] = []
    for number in range(goal + 1):
        links = [link for link in order.links if link.target == number]
        waits = [link.source for link in links] + [earlier for earlier, later in order.orders if later == number]
        below = boxes if number == goal else [boxes[one] for one in waits]
        lines = ["goal"] if number == goal else [f"{number + 1}  {order.steps[number].schema}"]
        if number < goal and order.steps[number].arguments:
            lines += wrap(", ".join(order.steps[number].arguments), _LETTERS)
        for link in links:
            lines += [line for need in link.needs for line in wrap(f"{link.source + 1} → {need}", _LETTERS)]
        row = max((box.row + 1 for box in below), default=0)
        boxes.append(_Box(row, tuple(lines), number == goal))
    return boxes


def _path(source: _Box, target: _Box, rows: list[list[_Box]]) -> list[_Box]:
    """Return the boxes that an arrow joins, with a place of its own in each row that it passes."""
    path = [source]
    for row in range(source.row + 1, target.row):
        lane = _Box(row, above=[path[-1]])
        rows[row].append(lane)
        path.append(lane)
    target.above.append(path[-1])
    return [*path, target]


def _place(rows: list[list[_Box]]) -> tuple[float, float]:
    y = 2 * _GAP
    for row in rows:
        row.sort(key=_wish)
        right = _GAP
        for box in row:
            box.x, box.y = max(right, _wish(box) - box.width / 2), y
            right = box.x + box.width + _GAP
        tallest = max(box.height for box in row)
        for box in row:
            box.passed = tallest
        y += tallest + _ROW_GAP
    right = max(box.x + box.width for row in rows for box in row) + _GAP
    return right, y - _ROW_GAP + _GAP


def _wish(box: _Box) -> float:
    return sum(one.middle for one in box.above) / len(box.above) if box.above else 0.0


def _arrow(path: list[_Box], later: bool) -> str:
    colour, marker = (_LATER, "wait") if later else (_EDGE, "so")
    parts = [f"M{path[0].middle:g} {path[0].y + path[0].height:g}"]
    for before, box in pairwise(path):
        top, bottom = before.y + before.height, box.y
        half = (top + bottom) / 2
        parts.append(f"C{before.middle:g} {half:g} {box.middle:g} {half:g} {box.middle:g} {bottom:g}")
        parts += [] if box.lines else [f"L{box.middle:g} {bottom + box.height:g}"]
    style = ' stroke-dasharray="5 4"' if later else ""
    return f'<path d="{"".join(parts)}" fill="none" stroke="{colour}"{style} marker-end="url(#{marker})"/>'
