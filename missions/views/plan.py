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
from rosa_pddl import Certificate, Domain, PlanningResult, State, Step
from rosa_pddl.domain import Formula
from rosa_pddl.grounding import binding_of
from rosa_pddl.validate import ended, mentioned_atoms, started

_LETTERS: Final = 38
"""The longest line in a box [characters]."""
_GAP, _ROW_GAP, _ENTRY = 24.0, 14.0, 12.0
"""Sizes in pixels."""
_FONT: Final = 'font-family="sans-serif" font-size="12"'
_LINE: Final = 16.0
_LETTER: Final = 6.9  # a little more than the average width of a character [px]
_EDGE: Final = "#46627f"
_MARKER: Final = (
    '<defs><marker id="needs" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">'
    f'<path d="M0 0L8 4L0 8z" fill="{_EDGE}"/></marker></defs>'
)
_STEP, _GOAL = (f'fill="{fill}" stroke="{_EDGE}"' for fill in ("#eef3f8", "#d5ecd4"))


class Link(NamedTuple):
    """A step that makes true the atoms that a later step or the goal needs."""

    source: int
    target: int
    needs: tuple[str, ...]


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
        links = links_of(answer)
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


def links_of(answer: Answer) -> tuple[Link, ...]:
    """Return which step of an answer makes true what another one, or the goal, needs."""
    question = answer.question
    goals = [goal.expression for goal in question.goals]
    return causal_links(question.domain, answer.result.steps, question.problem.state, goals)


def causal_links(
    domain: Domain, steps: Sequence[Step], state: State, goals: Iterable[Formula]
) -> tuple[Link, ...]:
    """Return which step of a plan makes true what another one, or the goal, needs."""
    changers: dict[str, int] = {}
    links: list[Link] = []

    def need(target: int, needed: Iterable[str]) -> None:
        facts: defaultdict[int, list[str]] = defaultdict(list)
        for atom in sorted(changers.keys() & needed):
            facts[changers[atom]].append(atom if atom in state else f"(not {atom})")
        links.extend(Link(source, target, tuple(atoms)) for source, atoms in sorted(facts.items()))

    for number, step in enumerate(steps):
        schema = domain.schema_of[step.schema]
        binding = binding_of(domain, step)
        meanwhile = started(domain, step, state)
        after = ended(domain, step, meanwhile)
        needed = set(mentioned_atoms(domain, schema.start, schema.start_effects, binding))
        later = mentioned_atoms(domain, schema.over_all + schema.end, schema.end_effects, binding)
        need(number, needed | (set(later) - (state ^ meanwhile)))
        changers |= dict.fromkeys((state ^ meanwhile) | (meanwhile ^ after), number)
        state = after
    need(len(steps), set(mentioned_atoms(domain, goals, (), {})))
    return tuple(links)


class _Box(NamedTuple):
    """A step or the goal: upper left corner [px], lines of text, width and height [px]."""

    x: float
    y: float
    lines: list[str]
    width: float
    height: float


def svg_of(steps: Sequence[Step], links: Sequence[Link], title: str) -> str:
    """Draw a plan in layers, from top to bottom: each step is below all that it needs.

    An arrow has the facts that one step makes true for another.
    """
    boxes: dict[int, _Box] = {}
    top = 2 * _GAP
    for layer in _layers(len(steps), links):
        enter = {number: [link for link in links if link.target == number] for number in layer}
        places = {number: _mean_x(boxes, enter[number]) for number in layer}
        top += _LINE * max(map(len, enter.values()), default=0) + _GAP
        x = _GAP
        for number in sorted(layer, key=lambda number: (places[number], number)):
            lines = _lines(steps, number)
            width, height = _box_size(lines)
            labels = [
                _LETTER * len(" ".join(link.needs)) + _ENTRY * place
                for place, link in enumerate(enter[number])
            ]
            boxes[number] = _Box(x, top, lines, max([width, *labels]), height)
            x += boxes[number].width + _GAP
        top += max(boxes[number].height for number in layer) + _ROW_GAP
    widest = max(box.x + box.width for box in boxes.values())
    width = max(widest + _GAP, 2 * _GAP + 1.1 * _LETTER * len(title))
    height = top + _GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" {_FONT}>',
        f"<title>{escape(title)}</title>",
        _MARKER,
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
        f'<text x="{_GAP:g}" y="{_GAP:g}" font-weight="bold">{escape(title)}</text>',
    ]
    for link in links:
        parts += _arrow(boxes, links, link)
    for number, box in sorted(boxes.items()):
        parts += _box(box.x, box.y, box.lines, _GOAL if number == len(steps) else _STEP)
    return "\n".join([*parts, "</svg>", ""])


def _layers(goal: int, links: Sequence[Link]) -> list[list[int]]:
    """Return the steps of each layer, below all that they need; the goal is alone in the last."""
    depths: list[int] = []
    for number in range(goal):
        before = [depths[link.source] + 1 for link in links if link.target == number]
        depths.append(max(before, default=0))
    depths.append(max(depths, default=-1) + 1)
    layers: list[list[int]] = [[] for _ in range(depths[-1] + 1)]
    for number, depth in enumerate(depths):
        layers[depth].append(number)
    return layers


def _mean_x(boxes: Mapping[int, _Box], links: Sequence[Link]) -> float:
    """Return where the needed steps stand on average [px], so that arrows are short."""
    return sum(boxes[link.source].x for link in links) / max(len(links), 1)


def _lines(steps: Sequence[Step], number: int) -> list[str]:
    if number == len(steps):
        return ["goal"]
    step = steps[number]
    return [f"{number + 1}  {step.schema}", *wrap(", ".join(step.arguments), _LETTERS)]


def _arrow(boxes: Mapping[int, _Box], links: Sequence[Link], link: Link) -> Iterator[str]:
    """Yield an arrow and the facts beside its end; arrows to a step end beside one another."""
    source = boxes[link.source]
    target = boxes[link.target]
    place = [other for other in links if other.target == link.target].index(link)
    left = source.x + 8
    x = target.x + 8 + _ENTRY * place
    start = source.y + source.height
    turn = target.y - _LINE * (place + 1)
    path = f"M{left:g} {start:g}C{left:g} {turn:g} {x:g} {start:g} {x:g} {turn:g}V{target.y:g}"
    yield f'<path d="{path}" fill="none" stroke="{_EDGE}" marker-end="url(#needs)"/>'
    halo = 'stroke="white" stroke-width="3" paint-order="stroke"'
    words = escape(" ".join(link.needs))
    yield f'<text x="{x + 5:g}" y="{turn + _LINE * 0.7:g}" {halo}>{words}</text>'


def _box_size(lines: Sequence[str]) -> tuple[float, float]:
    """Return width and height of a box with lines of text [px]; the first line is bold."""
    longest = max(len(line) * (1.1 if line is lines[0] else 1.0) for line in lines)
    return 16 + _LETTER * longest, 10 + _LINE * len(lines)


def _box(x: float, y: float, lines: Sequence[str], style: str) -> Iterator[str]:
    """Yield the SVG elements of a box with lines of text; (x, y) is its upper left corner [px]."""
    width, height = _box_size(lines)
    yield f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5" {style}/>'
    for number, line in enumerate(lines):
        weight = 'font-weight="bold"' if number == 0 else 'fill="#444444"'
        yield f'<text x="{x + 8:g}" y="{y + 17 + number * _LINE:g}" {weight}>{escape(line)}</text>'
