"""Shows a plan to people: its steps with what they need, and a picture of their causal order.

The picture goes from top to bottom, to the goal: a step that waits for another is in a layer below
    it.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from textwrap import wrap
from typing import Final, NamedTuple

from missions.engine.question import Answer
from rosa_bt.display import FONT, LETTER, LINE, svg_box, svg_size
from rosa_pddl import Certificate, Domain, PlanningResult, State, Step
from rosa_pddl.domain import Formula
from rosa_pddl.grounding import binding_of
from rosa_pddl.validate import ended, mentioned_atoms, started

_LETTERS: Final = 38
"""The longest line in a box [characters]."""
_GAP, _ROW_GAP, _ENTRY = 24.0, 14.0, 12.0
"""Sizes in pixels."""
_MARKER: Final = (
    '<defs><marker id="{}" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="{}"/></marker></defs>'
)
_LEGEND: Final = "dashed: earlier, it would spoil what the other step needs"
_EDGE, _LATER = "#46627f", "#b06a00"
_STEP, _GOAL = (f'fill="{fill}" stroke="{_EDGE}"' for fill in ("#eef3f8", "#d5ecd4"))


class Link(NamedTuple):
    """A step that makes true the atoms that a later step or the goal needs."""

    source: int
    target: int
    needs: tuple[str, ...]


class CausalOrder(NamedTuple):
    """Why the steps of a plan come in their order.

    Steps that it does not order may change places.
    """

    steps: tuple[Step, ...]
    links: tuple[Link, ...]
    orders: tuple[tuple[int, int], ...]
    """(earlier, later): the later step would undo what the earlier one needs or does, and no links
    order them."""


def lines_of(answer: Answer) -> Iterator[str]:
    """Yield a plan, a line for each step with the steps that it needs.

    Or the reason why there is no plan.
    """
    question = answer.question
    result = answer.result
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
    yield from result.assumptions
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
        "assumptions": list(result.assumptions),
    }


def certificate_lines(certificate: Certificate) -> Iterator[str]:
    """Yield the plan for each set of unfeasible actions, and the failures that end the mission."""
    rows = [("unfeasible", "cost", "plan")]
    for out, result in certificate.entries.items():
        plan = ", ".join(map(str, result.steps)) or "nothing is left to do"
        cost = "" if result.cost is None else f"{result.cost:g}"
        found = plan if result.outcome.is_solved else f"no plan: {result.outcome}"
        rows.append((", ".join(out) or "none", cost, found))
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    yield from (f"{out:<{widths[0]}}  {cost:>{widths[1]}}  {plan}" for out, cost, plan in rows)
    for cause, result in certificate.causes.items():
        if result.assumptions:
            yield f"{cause}: {'; '.join(result.assumptions)}"
    yield f"single failures that end the mission: {', '.join(certificate.fatal) or 'none'}"


def certificate_as_data(certificate: Certificate) -> dict[str, object]:
    entries = [
        {"unfeasible": list(out), **as_data(result)} for out, result in certificate.entries.items()
    ]
    causes = [{"cause": cause, **as_data(result)} for cause, result in certificate.causes.items()]
    return {"fatal": list(certificate.fatal), "entries": entries, "causes": causes}


def causes_of(answer: Answer) -> CausalOrder:
    question = answer.question
    goals = [goal.expression for goal in question.goals]
    return causal_order(question.domain, answer.result.steps, question.problem.state, goals)


def causal_order(
    domain: Domain, steps: Sequence[Step], state: State, goals: Iterable[Formula]
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
            needed = set(mentioned_atoms(domain, goals, (), {}))
            changed = frozenset()
            after = state
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
    schema = domain.schema_of[step.schema]
    binding = binding_of(domain, step)
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
        for earlier in sorted(
            (first for first, second in threats if second == later), reverse=True
        ):
            if earlier not in before[later]:
                orders.append((earlier, later))
                before[later] |= {earlier, *before[earlier]}
    return tuple(sorted(orders))


def svg_of(order: CausalOrder, title: str) -> str:
    """Draw a plan in layers, from top to bottom: each step is below all that it waits for.

    An arrow has the facts that one step makes true for another; a dashed one is for a step that
    only has to wait.
    """
    arrows = [(link.source, link.target, " ".join(link.needs)) for link in order.links]
    arrows += [(earlier, later, "") for earlier, later in order.orders]
    layers = _layers(len(order.steps), arrows)
    boxes: dict[int, _Box] = {}
    top = 2 * _GAP
    for layer in layers:
        enter = {number: [arrow for arrow in arrows if arrow[1] == number] for number in layer}
        middles = {number: _middle(boxes, enter[number]) for number in layer}
        top += LINE * max(map(len, enter.values()), default=0) + _GAP
        x = _GAP
        for number in sorted(layer, key=lambda number: (middles[number], number)):
            lines = _lines(order, number)
            width, height = svg_size(lines)
            labels = [
                LETTER * len(words) + _ENTRY * place
                for place, (*_, words) in enumerate(enter[number])
            ]
            boxes[number] = _Box(x, top, lines, max([width, *labels]), height)
            x += boxes[number].width + _GAP
        top += max(boxes[number].height for number in layer) + _ROW_GAP
    legend = LETTER * len(_LEGEND) if order.orders else 0.0
    widest = max([box.x + box.width for box in boxes.values()])
    width = max(widest + _GAP, 2 * _GAP + max(1.1 * LETTER * len(title), legend))
    height = top + _GAP + (LINE if order.orders else 0.0)
    body = [part for arrow in arrows for part in _arrow(boxes, arrows, arrow)]
    for number, box in sorted(boxes.items()):
        body += svg_box(*box[:3], _GOAL if number == len(order.steps) else _STEP)
    if order.orders:
        body.append(f'<text x="{_GAP:g}" y="{height - 8:g}" fill="{_LATER}">{_LEGEND}</text>')
    markers = [_MARKER.format(name, colour) for name, colour in (("so", _EDGE), ("wait", _LATER))]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}"',
            f"{FONT}>",
            f"<title>{escape(title)}</title>",
            *markers,
            f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
            f'<text x="{_GAP:g}" y="{_GAP:g}" font-weight="bold">{escape(title)}</text>',
            *body,
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


_Arrow = tuple[int, int, str]
"""The earlier step, the later one, and the facts; no facts if the later one only has to wait."""


def _layers(goal: int, arrows: Sequence[_Arrow]) -> list[list[int]]:
    """Return the steps of each layer.

    A step is one layer below the lowest that it waits for, the goal is last.
    """
    depths: list[int] = []
    for number in range(goal):
        before = [depths[earlier] + 1 for earlier, later, _ in arrows if later == number]
        depths.append(max(before, default=0))
    depths.append(max(depths, default=-1) + 1)
    layers: list[list[int]] = [[] for _ in range(depths[-1] + 1)]
    for number, depth in enumerate(depths):
        layers[depth].append(number)
    return layers


def _middle(boxes: Mapping[int, _Box], arrows: Sequence[_Arrow]) -> float:
    """Return where the steps before stand on average [px], so that arrows are short."""
    places = [boxes[earlier].x for earlier, *_ in arrows]
    return sum(places) / len(places) if places else 0.0


def _lines(order: CausalOrder, number: int) -> list[str]:
    if number == len(order.steps):
        return ["goal"]
    step = order.steps[number]
    return [f"{number + 1}  {step.schema}", *wrap(", ".join(step.arguments), _LETTERS)]


def _arrow(boxes: Mapping[int, _Box], arrows: Sequence[_Arrow], arrow: _Arrow) -> Iterator[str]:
    """Yield an arrow and the facts beside its end; the arrows to a step end beside one another."""
    earlier, later, words = arrow
    source = boxes[earlier]
    target = boxes[later]
    place = [each for each in arrows if each[1] == later].index(arrow)
    x = target.x + 8 + _ENTRY * place
    start = source.y + source.height
    end = target.y
    turn = end - LINE * (place + 1)
    left = source.x + 8
    way = f"M{left:g} {start:g}C{left:g} {turn:g} {x:g} {start:g} {x:g} {turn:g}V{end:g}"
    style = f'stroke="{_EDGE}"' if words else f'stroke="{_LATER}" stroke-dasharray="5 4"'
    marker = "so" if words else "wait"
    yield f'<path d="{way}" fill="none" {style} marker-end="url(#{marker})"/>'
    if words:
        halo = 'stroke="white" stroke-width="3" paint-order="stroke"'
        yield f'<text x="{x + 5:g}" y="{turn + LINE * 0.7:g}" {halo}>{escape(words)}</text>'
