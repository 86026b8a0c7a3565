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
    by_action = [(", ".join(out) or "none", each) for out, each in certificate.entries.items()]
    for failure, result in [*by_action, *certificate.causes.items()]:
        if result.assumptions:
            yield f"{failure}: {'; '.join(result.assumptions)}"
    alone = [result for out, result in certificate.entries.items() if len(out) < 2]
    fatal = ", ".join(certificate.fatal)
    if any(result.assumptions for result in [*alone, *certificate.causes.values()]):
        others = f"{fatal}; no others" if fatal else "none"
        fatal = f"{others}, if what is assumed above holds"
    yield f"single failures that end the mission: {fatal or 'none'}"


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


def svg_of(steps: Sequence[Step], links: Sequence[Link], title: str) -> str:
    """Draw a plan in layers, from top to bottom: each step is below all that it needs.

    An arrow has the facts that one step makes true for another.
    """
    texts = [
        [f"{number}  {step.schema}", *wrap(", ".join(step.arguments), _LETTERS)]
        for number, step in enumerate(steps, start=1)
    ]
    texts.append(["goal"])
    needs = [[link for link in links if link.target == number] for number in range(len(texts))]
    width = 16 + _LETTER * max(len(line) * 1.1 for lines in texts for line in lines)
    height = 10 + _LINE * max(map(len, texts))
    label = max((len(" ".join(link.needs)) for link in links), default=0)
    column = _GAP + max(width, _LETTER * label + _ENTRY * max(map(len, needs)))
    places: dict[int, tuple[float, float]] = {}
    y = 2 * _GAP
    for layer in _layers(needs):
        y += _GAP + _LINE * max(len(needs[number]) for number in layer)
        layer.sort(key=lambda number: _mean_x(places, needs[number]))
        for place, number in enumerate(layer):
            places[number] = _GAP + place * column, y
        y += height + _ROW_GAP
    arrows: list[str] = []
    boxes: list[str] = []
    for number, (x, top) in sorted(places.items()):
        style = _GOAL if number == len(steps) else _STEP
        box = f'<rect x="{x:g}" y="{top:g}" width="{width:g}" height="{height:g}" rx="5" {style}/>'
        boxes += [box, *_lines(x + 8, top + 17, texts[number])]
        for place, link in enumerate(needs[number]):
            source_x, source_y = places[link.source]
            start = source_x + 8, source_y + height
            arrows += _arrow(start, (x + 8 + _ENTRY * place, top), place, " ".join(link.needs))
    right = max(max(x for x, _ in places.values()) + column, 1.1 * _LETTER * len(title)) + _GAP
    size = f'width="{right:g}" height="{y + _GAP:g}"'
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} {_FONT}>',
            f"<title>{escape(title)}</title>",
            _MARKER,
            f'<rect {size} fill="white"/>',
            *_lines(_GAP, _GAP, [title]),
            *arrows,
            *boxes,
            "</svg>\n",
        ]
    )


def _layers(needs: Sequence[Sequence[Link]]) -> list[list[int]]:
    """Return the steps of each layer, below all that they need; the goal is alone in the last."""
    depths: list[int] = []
    for links in needs[:-1]:
        depths.append(max((depths[link.source] + 1 for link in links), default=0))
    layers = [
        [number for number, its_depth in enumerate(depths) if its_depth == depth]
        for depth in range(max(depths, default=-1) + 1)
    ]
    return [*layers, [len(depths)]]


def _mean_x(places: Mapping[int, tuple[float, float]], links: Sequence[Link]) -> float:
    """Return where the needed steps stand on average [px], so that arrows are short."""
    return sum(places[link.source][0] for link in links) / max(len(links), 1)


def _arrow(
    start: tuple[float, float], end: tuple[float, float], place: int, words: str
) -> Iterator[str]:
    """Yield an arrow and its words beside its end; arrows to a step end beside one another."""
    left, top = start
    x, y = end
    turn = y - _LINE * (place + 1)
    path = f"M{left:g} {top:g}C{left:g} {turn:g} {x:g} {top:g} {x:g} {turn:g}V{y:g}"
    yield f'<path d="{path}" fill="none" stroke="{_EDGE}" marker-end="url(#needs)"/>'
    halo = 'stroke="white" stroke-width="3" paint-order="stroke"'
    yield f'<text x="{x + 5:g}" y="{turn + _LINE * 0.7:g}" {halo}>{escape(words)}</text>'


def _lines(x: float, y: float, lines: Sequence[str]) -> Iterator[str]:
    """Yield lines of text, of which the first is bold."""
    for number, line in enumerate(lines):
        weight = 'fill="#444444"' if number else 'font-weight="bold"'
        yield f'<text x="{x:g}" y="{y + number * _LINE:g}" {weight}>{escape(line)}</text>'
