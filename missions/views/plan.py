"""Shows a plan to people: its steps with what they need, and a picture of their causal order.

The picture goes from top to bottom, to the goal: a step that waits for another is below it and further to the right.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from textwrap import wrap
from typing import Final, NamedTuple

from missions.engine.question import Answer
from rosa_bt.display import FONT, LETTER, LINE, svg_box, svg_size
from rosa_pddl import Certificate, Domain, PlanningResult, State, Step
from rosa_pddl.domain import UpThing
from rosa_pddl.validate import binding_of, ended, mentioned_atoms, started

_LETTERS: Final = 38
"""The longest line in a box [characters]."""
_GAP, _ROW_GAP, _INDENT = 24.0, 14.0, 40.0
"""Sizes in pixels."""
_MARKER: Final = (
    '<defs><marker id="{}" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="{}"/></marker></defs>'
)
_LEGEND: Final = "dashed: earlier, it would spoil what the other step needs"
_EDGE, _LATER = "#46627f", "#b06a00"
_STEP, _GOAL = (f'fill="{fill}" stroke="{_EDGE}"' for fill in ("#eef3f8", "#d5ecd4"))


class Link(NamedTuple):
    """A step (numbered from 0) makes true the (negated) atoms that a later step needs, or the goal, which is last."""

    source: int
    target: int
    needs: tuple[str, ...]


class CausalOrder(NamedTuple):
    """Why the steps of a plan come in their order; steps that it does not order may change places."""

    steps: tuple[Step, ...]
    links: tuple[Link, ...]
    orders: tuple[tuple[int, int], ...]
    """(earlier, later): the later step would undo what the earlier one needs or does, and no links order them."""


def lines_of(answer: Answer) -> Iterator[str]:
    """Yield a plan, a line for each step with the steps that it needs; or the reason why there is no plan."""
    question, result = answer.question, answer.result
    if not result.outcome.is_solved:
        yield f"no plan: {result.message or result.outcome}"
        yield from (f"  {obstacle}" for obstacle in answer.obstacles)
    else:
        steps = "1 step" if len(result.steps) == 1 else f"{len(result.steps)} steps"
        yield f"{result.outcome} by {result.engine}: {steps}, cost {result.cost or 0:g}"
        links = causes_of(answer).links
        for number, step in enumerate(result.steps):
            needs = [
                f"{' '.join(link.needs)} by {link.source + 1}"
                for link in links
                if link.target == number
            ]
            yield f"  {number + 1}  {step}" + (f"  needs {', '.join(needs)}" if needs else "")
    yield from (
        f"out: {question.kb.why(question.kb.actions[action])}" for action in question.unfeasible
    )
    yield from (f"note: {oversight}" for oversight in question.oversights)


def as_data(result: PlanningResult) -> dict[str, object]:
    steps = [{"action": step.schema, "arguments": list(step.arguments)} for step in result.steps]
    return {
        "outcome": str(result.outcome),
        "engine": result.engine,
        "cost": result.cost,
        "steps": steps,
    }


def certificate_lines(certificate: Certificate) -> Iterator[str]:
    """Yield a table: the plan for each combination of unfeasible actions, and the failures that end the mission."""
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
    entries = [
        {"unfeasible": list(out), **as_data(result)} for out, result in certificate.entries.items()
    ]
    return {"fatal": list(certificate.fatal), "entries": entries}


def causes_of(answer: Answer) -> CausalOrder:
    question = answer.question
    goals = [goal.expression for goal in question.goals]
    return causal_order(question.domain, answer.result.steps, question.problem.state, goals)


def causal_order(
    domain: Domain, steps: Sequence[Step], state: State, goals: Iterable[UpThing]
) -> CausalOrder:
    """Return why the steps of a plan from a state to the goals come in their order."""
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
    """Return the atoms that a step needs, the atoms that it changes, and the state after it."""
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    needed = set(mentioned_atoms(domain, schema.start, schema.start_effects, binding))
    meanwhile = started(domain, step, state)
    changed = state ^ meanwhile
    needed |= (
        set(mentioned_atoms(domain, schema.over_all + schema.end, schema.end_effects, binding))
        - changed
    )
    after = ended(domain, step, meanwhile)
    return needed, changed | (meanwhile ^ after), after


def _beyond(
    links: Iterable[Link], threats: Iterable[tuple[int, int]], count: int
) -> tuple[tuple[int, int], ...]:
    """Return the threats that do not follow from a chain of links and other orders."""
    linked = {(link.source, link.target) for link in links}
    before: list[set[int]] = [set() for _ in range(count)]
    orders: list[tuple[int, int]] = []
    for later in range(count):
        for source in {source for source, target in linked if target == later}:
            before[later] |= {source, *before[source]}
        # the latest first: what comes before it then follows
        for earlier in sorted((one for one, other in threats if other == later), reverse=True):
            if earlier not in before[later]:
                orders.append((earlier, later))
                before[later] |= {earlier, *before[earlier]}
    return tuple(sorted(orders))


def svg_of(order: CausalOrder, title: str) -> str:
    """Draw a plan: an arrow for what one step makes true for another, a dashed one for a step that must wait."""
    goal, boxes, depths, height = len(order.steps), list[_Box](), list[int](), 2 * _GAP
    for number in range(goal + 1):
        links = [link for link in order.links if link.target == number]
        before = [link.source for link in links] + [
            earlier for earlier, later in order.orders if later == number
        ]
        depths.append(
            max((depths[one] + 1 for one in (range(goal) if number == goal else before)), default=0)
        )
        lines = _lines(order, number, links)
        boxes.append(_Box(_GAP + depths[number] * _INDENT, height, lines, *svg_size(lines)))
        height += boxes[-1].height + _ROW_GAP
    width = max(box.x + box.width for box in boxes) + _GAP
    width = max(
        width, 2 * _GAP + LETTER * max(1.1 * len(title), len(_LEGEND) if order.orders else 0)
    )
    height += LINE if order.orders else 0.0
    arrows = [_arrow(boxes, link.source, link.target, is_order=False) for link in order.links]
    arrows += [_arrow(boxes, earlier, later, is_order=True) for earlier, later in order.orders]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" {FONT}>',
            f"<title>{escape(title)}</title>",
            *(_MARKER.format(name, colour) for name, colour in (("so", _EDGE), ("wait", _LATER))),
            f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
            f'<text x="{_GAP:g}" y="{_GAP:g}" font-weight="bold">{escape(title)}</text>',
            *arrows,
            *(
                line
                for box in boxes
                for line in svg_box(*box[:3], _GOAL if box is boxes[-1] else _STEP)
            ),
            *(
                [f'<text x="{_GAP:g}" y="{height - 8:g}" fill="{_LATER}">{_LEGEND}</text>']
                if order.orders
                else []
            ),
            "</svg>",
            "",
        ]
    )


class _Box(NamedTuple):
    """A step or the goal: upper left corner [px], lines of text, width and height [px]."""

    x: float
    y: float
    lines: list[str]
    width: float
    height: float


def _lines(order: CausalOrder, number: int, links: Iterable[Link]) -> list[str]:
    lines = ["goal"]
    if number < len(order.steps):
        step = order.steps[number]
        lines = [f"{number + 1}  {step.schema}", *wrap(", ".join(step.arguments), _LETTERS)]
    return lines + [
        line
        for link in links
        for need in link.needs
        for line in wrap(f"{link.source + 1} → {need}", _LETTERS)
    ]


def _arrow(boxes: Sequence[_Box], earlier: int, later: int, *, is_order: bool) -> str:
    source, target = boxes[earlier], boxes[later]
    x, y = (
        source.x + 8 + 6 * (earlier % 5) + 3 * is_order,
        target.y + LINE * (1.1 if is_order else 0.6),
    )
    style = f'stroke="{_LATER}" stroke-dasharray="5 4"' if is_order else f'stroke="{_EDGE}"'
    way = f"M{x:g} {source.y + source.height:g}V{y:g}H{target.x:g}"
    return (
        f'<path d="{way}" fill="none" {style} marker-end="url(#{"wait" if is_order else "so"})"/>'
    )
