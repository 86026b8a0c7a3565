"""What a page shows of a knowledge base: elements, reasons, what-if cases, and causes of adaptations, as plain data."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf
from typing import Any, Final

from kb import Event, KnowledgeBase, Situation, Status
from kb.elements import (
    Action,
    Attribute,
    Component,
    Configuration,
    Constraint,
    Function,
    FunctionDesign,
)
from kb.measurements import turning_point
from kb.network import Node
from kb.planners import Choice, choice_by_priority, ranked
from kb.state import Overlay, State
from missions.engine.adaptations import Adaptation
from missions.views.output import plain

CHOSEN = ("function", "component")
"""The kinds of elements for which a design or a configuration is chosen."""
_CASES: Final = 60


def described(node: Node, units: Mapping[str, str]) -> dict[str, Any]:
    """Return an element as plain values; the elements that it refers to are given by their indices."""
    one, parts, wholes = (
        node.element,
        [part.index for part in node.parts],
        [whole.index for whole in node.wholes],
    )
    shown: dict[str, Any] = {"kind": node.kind, "name": node.name}
    if isinstance(one, Constraint):
        fields = {name: getattr(one, name) for name in ("operator", "value", "hysteresis", "dwell")}
        return shown | fields | {"attribute": parts[0], "on": wholes}
    constraints = [each.index for each in node.constraints]
    if isinstance(one, Attribute):
        shown |= {
            "of": str(one.kind),
            "unit": units.get(one.name, one.unit),
            "max_age": plain(one.max_age),
        }
        return shown | {"thresholds": constraints}
    shown["constraints"] = constraints
    if isinstance(one, Action):
        shown["functions"] = parts
    elif isinstance(one, Function):
        shown["designs"] = parts
    elif isinstance(one, FunctionDesign):
        shown |= {"function": wholes[0], "components": parts, "priority": one.priority}
    elif isinstance(one, Component):
        shown |= {"switched": str(one.kind), "configurations": parts}
    elif isinstance(one, Configuration):
        shown |= {
            "component": wholes[0],
            "priority": one.priority,
            "parameters": plain(one.parameters),
        }
    return shown


def choice_of(kb: KnowledgeBase, node: Node) -> dict[str, Any]:
    """Return why a function or component has the design or configuration that it has, and not another one."""
    found = kb.explain_choice(node.element)
    parts = {part.name: part.index for part in node.parts}
    return {
        "chosen": None if found.chosen is None else parts[found.chosen],
        "selected": found.is_selected,
        "reason": found.reason,
        "alternatives": [
            {
                "element": parts[one.name],
                "status": str(one.status),
                "priority": one.priority,
                "reason": one.reason,
            }
            for one in found.alternatives
        ],
    }


def supposed(situation: Situation) -> dict[str, Any]:
    """Return what would be feasible in a situation, and what would be selected in it, by priority."""
    with situation.reading() as state:
        assert isinstance(state, Overlay)
        network, choice = state.network, choice_by_priority(state) or Choice({}, {})
        chosen: dict[str, int | None] = {}
        for kind, following in (("function", choice.designs), ("component", choice.configurations)):
            for node in network.kinds[kind].values():
                possible = ranked(state, node)  # the first is what would be selected if nothing is
                name = following.get(node.name)
                kept = [
                    one
                    for one in possible
                    if (state.selected[one.index] if name is None else one.name == name)
                ]
                if node.parts:
                    chosen[str(node.index)] = next((part.index for part in kept or possible), None)
        status = {str(index): str(state.status[index]) for index in sorted(state.changed())}
        feasible = [network.actions[name].index for name in situation.selectable_actions()]
    return {"feasible": feasible, "status": status, "chosen": chosen}


def cases(kb: KnowledgeBase) -> list[dict[str, Any]]:
    """Return what would be feasible with another value of each measured attribute; at most 60 cases.

    One value of each interval between thresholds is tried: all values in an interval give the same statuses.
    """
    with kb.reading() as state:
        intervals = [
            (node, measured, low, high)
            for node in state.network.attributes.values()
            if node.constraints and (measured := state.value[node.index]) is not None
            for low, high in _intervals(node, state)
        ][:_CASES]
    found = []
    for node, value, low, high in intervals:
        is_now = low <= value < high
        if not is_now:
            span = (
                high - low
                if -inf < low and high < inf
                else max(abs(low if high == inf else high), 1.0) * 0.2
            )
            value = low + span / 2 if low > -inf else high - span / 2
        case = {
            "attribute": node.index,
            "low": plain(low),
            "high": plain(high),
            "value": value,
            "now": is_now,
        }
        found.append(case | supposed(kb.situation({node.name: value})))
    return found


def _intervals(attribute: Node, state: State) -> Iterator[tuple[float, float]]:
    turns = set()
    for node in attribute.constraints:
        assert isinstance(node.element, Constraint)
        turns |= {node.element.value, turning_point(node.element, state.status[node.index])}
    edges = [-inf, *sorted(turns), inf]
    return pairwise(edges)


_OPPOSITE: Final = {">=": "<", ">": "<=", "<=": ">", "<": ">="}
_NAMED: Final = 3
"""How many elements a link names; it counts the rest."""

Names = Mapping[tuple[str, str], int]


# -------------------------------------------------------------------- from the cause of an adaptation to its effect


def chain_of(
    adaptation: Adaptation,
    events: Sequence[Event],
    task_plans: Iterable[Any],
    names: Names,
    nodes: Mapping[int, Sequence[int]],
) -> list[dict[str, Any]]:
    """Return the links of the chain from news to effect, in that order.

    `names` gives the index of an element by kind and name, `nodes` the ids of the behaviours that use an action.
    """
    links: list[dict[str, Any]] = []

    def link(
        time: float, what: str, words: str, elements: Iterable[int] = (), event: int | None = None
    ) -> None:
        about = list(dict.fromkeys(elements))
        uids = [uid for index in about for uid in nodes.get(index, ())]
        links.append(
            {
                "t": time,
                "what": what,
                "words": words,
                "event": event,
                "elements": about,
                "nodes": uids,
            }
        )

    by_number = {event.number: event for event in events}
    news = [by_number[number] for number in adaptation.events if number in by_number]
    for event in news:
        link(event.time, "news", _news(event), _subjects(event, names), event.number)
    if not news:
        link(adaptation.news_s, "news", adaptation.trigger)
    for event in news:
        changed = _telling(event)
        if changed:
            more = f" and {len(changed) - _NAMED} more" if len(changed) > _NAMED else ""
            words = ", ".join(f"{one.name} {one.new}" for one in changed[:_NAMED]) + more
            link(
                event.time,
                "status",
                words,
                [names[one.kind, one.name] for one in changed],
                event.number,
            )
    start, plan = adaptation.news_s - 1e-9, None
    for one in task_plans:
        if start <= one.at_s <= adaptation.at_s and (
            one.cause is None or one.cause in adaptation.events or not news
        ):
            plan = one
    if plan is not None:
        steps = ", then ".join(dict.fromkeys(step.action or step.schema for step in plan.steps))
        found = f"replanned: {steps}" if plan.outcome.is_solved else f"no plan: {plan.outcome}"
        link(plan.at_s, "replan", found, event=plan.cause)
    for verb, action, words in (
        ("cancel_action", adaptation.before, "stopped"),
        ("request_action", adaptation.action, "requested"),
    ):
        made = [
            one
            for one in events
            if one.verb == verb and one.subject == action and start <= one.time
        ]
        if action and made:
            what = "end" if verb == "cancel_action" else "request"
            link(
                made[-1].time, what, f"{action} {words}", [names["action", action]], made[-1].number
            )
    for words, done in adaptation.plans:
        number = next((one.number for one in reversed(events) if one.plan is done), None)
        elements = [names["component", name] for name in (*done.deactivate, *done.activate)]
        elements += [names["configuration", name] for name in done.parameters]
        link(done.start, "plan", words, elements, number)
    if adaptation.reaction_s is not None:
        link(
            adaptation.in_force_s, "force", f"in force {adaptation.reaction_s:.2f} s after the news"
        )
    order = ["news", "status", "replan", "end", "request", "plan", "force"]
    return sorted(links, key=lambda one: (one["t"], order.index(one["what"])))


def _news(event: Event) -> str:
    """Return an event in words; for a measurement, with the threshold that it crossed."""
    for change in event.changes:
        if event.verb == "measure" and change.kind == "constraint" and " just " not in event.text:
            _, operator, threshold = change.name.split(" ", 2)
            shown = (
                operator if change.new is not Status.VIOLATED else _OPPOSITE.get(operator, operator)
            )
            return f"{event.text.replace(' is ', ' ', 1)} {shown} {threshold}"
    return event.text


def _subjects(event: Event, names: Names) -> list[int]:
    kind = "attribute" if event.verb in ("measure", "stale", "dwell") else "component"
    found = [names[kind, event.subject]] if (kind, event.subject) in names else []
    return found + [names[one.kind, one.name] for one in event.changes if one.kind == "constraint"]


def _telling(event: Event) -> list[Any]:
    """Return the most telling changes: feasibility of actions, else of other elements, else any other."""
    turned = [
        one
        for one in event.changes
        if (one.old is Status.UNFEASIBLE) != (one.new is Status.UNFEASIBLE)
    ]
    actions = [one for one in turned if one.kind == "action"]
    others = [one for one in event.changes if one.kind not in ("constraint", "action")]
    return actions or [one for one in turned if one.kind != "constraint"] or others
