"""The knowledge base as plain data for a page: elements, reasons, what-if cases, causes."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice, pairwise
from math import inf, isfinite
from typing import Any, Final

from kb import Event, KnowledgeBase, Situation, Status
from kb.network import Node
from kb.planning import Choice, choice_by_priority
from kb.state import State
from missions.engine.adaptations import Adaptation
from missions.views.output import plain

_CASES: Final = 60
_NAMED: Final = 3
"""How many elements a link names; it counts the rest."""
_ORDER: Final = ("news", "status", "replan", "end", "request", "plan", "force")
_FIELDS: Final[Mapping[str, Sequence[str]]] = {
    "attribute": ("unit", "max_age"),
    "constraint": ("operator", "value", "hysteresis", "dwell"),
    "configuration": ("parameters",),
}
"""What a page shows of an element besides its links, by kind."""
_FACTS: Final[Mapping[str, Callable[[State, Node], Any]]] = {
    "status": lambda state, node: state.status.get(node),
    "required": State.is_required,
    "selected": lambda state, node: node in state.selected,
    "active": lambda state, node: node in state.active,
    "stale": lambda state, node: node in state.stale,
    "parameters": lambda state, node: plain(state.parameters.get(node)),
}
"""The tracks of a page about an element, each with the fact that it shows."""


def key_of(node: Node) -> str:
    """Return what stands for an element in rows, e.g. "component camera"."""
    return " ".join(map(str, node.ref))


def described(node: Node) -> dict[str, Any]:
    """Return an element as plain data that refers to others by key."""
    data: dict[str, Any] = {"kind": node.kind, "name": node.name}
    data |= {name: plain(getattr(node.element, name)) for name in _FIELDS.get(node.kind, ())}
    links = {"requires": node.requires, "used_by": node.used_by, "constraints": node.constraints}
    return data | {name: [key_of(other) for other in others] for name, others in links.items()}


def facts_of(state: State) -> list[tuple[str, Node, dict[str, Any]]]:
    """Return each element with its key and its facts by track; a fact that is not so is None."""
    known = []
    for node in state.network.present():
        facts = {track: fact(state, node) or None for track, fact in _FACTS.items()}
        known.append((key_of(node), node, facts))
    return known


def reasons(kb: KnowledgeBase, node: Node) -> dict[str, Any]:
    """Return why an element has its status and its part, and what would help, by track."""
    explained = kb.explain(node.ref)
    remedies = [str(remedy) for remedy in explained.remedies]
    rows: dict[str, Any] = {"why": explained.sentence, "help": remedies or None}
    if node.kind in ("function", "component") and node.requires:
        choice = kb.explain_choice(node.ref)
        keys = {part.name: key_of(part) for part in node.requires}
        alternatives = [
            {
                "element": keys[other.name],
                "status": str(other.status),
                "priority": other.priority,
                "reason": other.reason,
            }
            for other in choice.alternatives
        ]
        chosen = None if choice.chosen is None else keys[choice.chosen]
        rows["choice"] = {"chosen": chosen, "reason": choice.reason, "alternatives": alternatives}
    return rows


# -------------------------------------------------------------------- what if


def supposed(base: KnowledgeBase, situation: Situation) -> dict[str, Any]:
    """Return what a situation makes feasible, what is chosen there, and which statuses differ."""
    with base.reading() as now:
        before = dict(now.status)
    status = {}
    chosen: dict[str, str | None] = {}
    with situation.reading() as state:
        choice = choice_by_priority(state) or Choice({}, {})
        chosen_now = {"function": choice.designs, "component": choice.configurations}
        for node in state.network.present():
            after = state.status.get(node)
            if after != before.get(node) and node.kind != "constraint":
                status[key_of(node)] = after
            if node.kind in chosen_now and node.requires:
                name = chosen_now[node.kind].get(node.name) or _selected(state, node)
                parts = [key_of(part) for part in node.requires if part.name == name]
                chosen[key_of(node)] = parts[0] if parts else None
    feasible = [f"action {name}" for name in situation.selectable_actions()]
    return {"feasible": feasible, "status": status, "chosen": chosen}


def _selected(state: State, node: Node) -> str:
    """Return the part that is selected and not unfeasible; empty if there is none."""
    for part in node.requires:
        if part in state.selected and state.status[part] is not Status.UNFEASIBLE:
            return part.name
    return ""


def cases(kb: KnowledgeBase) -> list[dict[str, Any]]:
    """Return what would be feasible if one value or one component were different.

    One value of each interval between thresholds is tried: all values in an interval give the same
    statuses. Each component is supposed to have failed, or to have recovered if it has failed.
    """
    tried: list[dict[str, Any]] = []
    with kb.reading() as state:
        intervals = list(islice(_intervals(state), _CASES))
    for name, value, low, high in intervals:
        is_now = low <= value < high
        case = {"attribute": f"attribute {name}", "low": plain(low), "high": plain(high)}
        situation = kb.situation({name: value if is_now else _inside(low, high)})
        tried.append(case | {"now": is_now} | supposed(kb, situation))
    for name, component in islice(kb.components.items(), _CASES):
        is_failed = component.status is Status.FAILURE
        verb = "recovered" if is_failed else "failed"
        situation = kb.situation(recovered=[name]) if is_failed else kb.situation(failed=[name])
        tried.append({"component": f"component {name}", "verb": verb} | supposed(kb, situation))
    return tried


def _intervals(state: State) -> Iterator[tuple[str, float, float, float]]:
    """Yield the intervals between the thresholds of each attribute: name, value now, low, high."""
    for node in state.network.attributes.values():
        turns = set()
        for limit in node.constraints:
            constraint = limit.constraint
            margin = constraint.hysteresis
            if state.status[limit] is not Status.VIOLATED:
                margin = 0.0
            elif constraint.operator in ("<=", "<"):
                margin = -margin
            turns.add(float(f"{constraint.value + margin:.15g}"))
        if turns and node in state.value:
            for low, high in pairwise([-inf, *sorted(turns), inf]):
                yield node.name, state.value[node], low, high


def _inside(low: float, high: float) -> float:
    """Return a value between two ends, of which one may be infinite."""
    if isfinite(low) and isfinite(high):
        return low + (high - low) / 2
    end = low if isfinite(low) else high
    span = max(abs(end), 1.0) * 0.1
    return end + span if isfinite(low) else end - span


# -------------------------------------------------------------------- events, from cause to effect


def level_of(event: Event) -> str:
    """Return how serious an event is: "error", "warning" or "info"."""
    is_failed = event.verb == "component_failed" or "failed" in event.arguments[1:]
    if is_failed or any(change.new is Status.FAILURE for change in event.changes):
        return "error"
    is_vetoed = event.verb == "record_answer" and bool(event.arguments[1])
    is_lost = any(change.new is Status.UNFEASIBLE for change in event.changes)
    return "warning" if is_vetoed or is_lost else "info"


def chain_of(
    adaptation: Adaptation, events: Sequence[Event], task_plans: Sequence[Any]
) -> list[dict[str, Any]]:
    """Return the links of the chain from the cause of an adaptation to its effect, in that order.

    The newest events and task plans are enough.
    """
    links: list[dict[str, Any]] = []

    def link(time: float, what: str, words: str, elements: Iterable[str] = ()) -> None:
        links.append({"t": time, "what": what, "words": words, "elements": list(elements)})

    start = adaptation.news.time - 1e-9
    causes = [event for event in events if event.number in adaptation.news.events]
    for event in causes:
        link(event.time, "news", event.text, [_subject(event)])
        changes = _main_changes(event)
        if changes:
            words = ", ".join(f"{change.name} {change.new}" for change in changes[:_NAMED])
            if len(changes) > _NAMED:
                words += f" and {len(changes) - _NAMED} more"
            elements = [f"{change.kind} {change.name}" for change in changes]
            link(event.time, "status", words, elements)
    if not causes:
        link(adaptation.news.time, "news", adaptation.trigger)
    for plan in reversed(task_plans):
        is_for_it = not causes or plan.cause is None or plan.cause in adaptation.news.events
        if start <= plan.at_s <= adaptation.at_s and is_for_it:
            steps = ", then ".join(dict.fromkeys(step.action or step.schema for step in plan.steps))
            is_solved = plan.outcome.is_solved
            words = f"replanned: {steps}" if is_solved else f"no plan: {plan.outcome}"
            link(plan.at_s, "replan", words)
            break
    decisions = {
        ("cancel_action", adaptation.before): ("end", "stopped"),
        ("request_action", adaptation.action): ("request", "requested"),
    }
    for event in events:
        decision = decisions.get((event.verb, event.subject))
        if decision and start <= event.time <= adaptation.at_s + 1e-9:
            what, word = decision
            link(event.time, what, f"{event.subject} {word}", [f"action {event.subject}"])
    for words, done in adaptation.plans:
        elements = [f"component {name}" for name in (*done.deactivate, *done.activate)]
        elements += [f"configuration {name}" for name in done.parameters]
        link(done.start, "plan", words, elements)
    if adaptation.reaction_s is not None:
        words = f"in force {adaptation.reaction_s:.2f} s after the news"
        link(adaptation.in_force_s, "force", words)
    return sorted(links, key=lambda link: (link["t"], _ORDER.index(link["what"])))


def _subject(event: Event) -> str:
    """Return the key of the element that an event is about."""
    first = event.arguments[0]
    if isinstance(first, tuple):
        return f"{first[0]} {first[1]}"
    kind = "attribute" if event.verb in ("measure", "stale") else "component"
    return f"{kind} {first}"


def _main_changes(event: Event) -> list[Any]:
    """Return the actions that became feasible or unfeasible, else all changed elements."""
    changes = [change for change in event.changes if change.kind != "constraint"]
    actions = [change for change in changes if change.kind == "action"]
    turned = [change for change in actions if Status.UNFEASIBLE in (change.old, change.new)]
    return turned or [change for change in changes if change.kind != "action"]
