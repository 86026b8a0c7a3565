"""What a page shows of a knowledge base, as plain data: elements, reasons, what-if cases, causes of adaptations."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf
from typing import Any, Final

from kb import Event, KnowledgeBase, Situation, Status
from missions.engine.adaptations import Adaptation
from missions.views.output import plain

Names = Mapping[tuple[str, str], int]
"""The number of an element, by kind and name."""
Base = KnowledgeBase | Situation
_CASES: Final = 60
_CHOICES: Final = {
    "function": ("designs", "function design"),
    "component": ("configurations", "configuration"),
}
_FACTS: Final = {
    "action": {"required": "is_required"},
    "function": {"required": "is_required"},
    "function design": {"selected": "is_selected"},
    "component": {"required": "is_required", "active": "is_active"},
    "configuration": {"selected": "is_selected"},
    "attribute": {"stale": "is_stale"},
    "constraint": {},
}
"""The tracks of a page by kind of element, each with the property of a view that it shows."""


KINDS: Final = frozenset(_FACTS)


def views_of(base: Base) -> dict[str, Mapping[str, Any]]:
    """Return the views of a base by the kinds of elements, as events name them."""
    return {
        "action": base.actions,
        "function": base.functions,
        "function design": base.designs,
        "component": base.components,
        "configuration": base.configurations,
        "attribute": base.attributes,
    }


class ElementTable:
    """Numbers the elements of a knowledge base; an element keeps its number when the model is amended.

    Attributes:
        names: the number of each element that is there now, by kind and name.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.names: dict[tuple[str, str], int] = {}
        self._kb = kb
        self._numbers: dict[Any, int] = {}
        self._views: dict[int, tuple[str, Any]] = {}

    def describe(self, units: Mapping[str, str]) -> Iterator[tuple[int, dict[str, Any] | None]]:
        """Yield each element as plain data that refers to others by number; None for one that is gone."""
        before = set(self._views)
        self._views = {}
        owners: defaultdict[int, list[int]] = defaultdict(list)
        for kind, views in views_of(self._kb).items():
            for name, view in views.items():
                self._add((kind, name), kind, view)
        for number, (kind, view) in list(self._views.items()):
            for constraint in () if kind == "attribute" else view.constraints:
                owners[self._add(constraint.element, "constraint", constraint)].append(number)
        self.names = {(kind, view.name): number for number, (kind, view) in self._views.items()}
        limits: defaultdict[str, list[int]] = defaultdict(list)
        for number in owners:
            limits[self._views[number][1].attribute].append(number)
        for number, (kind, view) in self._views.items():
            data: dict[str, Any] = {"kind": kind, "name": view.name}
            if kind == "constraint":
                for field in ("operator", "value", "hysteresis", "dwell"):
                    data[field] = getattr(view.element, field)
                data |= {"attribute": self.names["attribute", view.attribute], "on": owners[number]}
            elif kind == "attribute":
                unit = units.get(view.name, view.unit)
                data |= {"of": str(view.kind), "unit": unit, "max_age": plain(view.max_age)}
                data["thresholds"] = limits[view.name]
            else:
                data["constraints"] = [self._numbers[one.element] for one in view.constraints]
                data |= self._relations(kind, view)
            yield number, data
        for number in sorted(before - set(self._views)):
            yield number, None

    def standing(self, kinds: Collection[str]) -> Iterator[tuple[int, str, str, bool | str]]:
        """Yield what holds of each element now: its number, its kind, a track of the page, and the value.

        Args:
            kinds: the kinds of elements whose statuses may have changed; other statuses are left out.
        """
        for number, (kind, view) in self._views.items():
            if kind in kinds and kind != "attribute":
                yield number, kind, "status", str(view.status)
            for track, fact in _FACTS[kind].items():
                yield number, kind, track, getattr(view, fact)

    def explain(self, number: int) -> dict[str, Any]:
        """Return why an element has its status, what would help, and what is chosen for whom it belongs to."""
        kind, view = self._views[number]
        explained = self._kb.explain(view)
        rows = {"why": explained.sentence, "help": [str(one) for one in explained.remedies] or None}
        return rows if kind not in _CHOICES else rows | self.choice(number)

    def choice(self, number: int) -> dict[str, Any]:
        """Return why a function or component has the design or configuration that it has; empty if it has none."""
        kind, view = self._views[number]
        parts, part_kind = _CHOICES[kind]
        if not getattr(view, parts):
            return {}
        explained = self._kb.explain_choice(view)
        alternatives = []
        for other in explained.alternatives:
            data = {"element": self.names[part_kind, other.name], "status": str(other.status)}
            alternatives.append(data | {"priority": other.priority, "reason": other.reason})
        chosen = None if explained.chosen is None else self.names[part_kind, explained.chosen]
        facts = {"chosen": chosen, "selected": explained.is_selected, "reason": explained.reason}
        return {"choice": facts | {"alternatives": alternatives}}

    def owner(self, number: int) -> int | None:
        """Return the function of a design or the component of a configuration; None for other elements."""
        kind, view = self._views[number]
        if kind == "function design":
            return self.names["function", view.function]
        return self.names["component", view.component] if kind == "configuration" else None

    def _add(self, key: Any, kind: str, view: Any) -> int:  # noqa: ANN401  # a view of any kind
        number = self._numbers.setdefault(key, len(self._numbers))
        self._views[number] = kind, view
        return number

    def _relations(self, kind: str, view: Any) -> dict[str, Any]:  # noqa: ANN401  # a view of any kind
        def numbers(kind: str, names: Iterable[str]) -> list[int]:
            return [self.names[kind, name] for name in names]

        if kind == "action":
            return {"functions": numbers("function", view.functions)}
        if kind == "function":
            return {"designs": numbers("function design", view.designs)}
        if kind == "component":
            configurations = numbers("configuration", view.configurations)
            return {"switched": str(view.kind), "configurations": configurations}
        if kind == "function design":
            used = {"components": numbers("component", view.components)}
            return used | {
                "function": self.names["function", view.function],
                "priority": view.priority,
            }
        owner = self.names["component", view.component]
        return {"component": owner, "priority": view.priority, "parameters": plain(view.parameters)}


def supposed(base: KnowledgeBase, situation: Situation, names: Names) -> dict[str, Any]:
    """Return what would be feasible in a situation, what would be selected by priority, and which statuses differ."""
    adaptable = set(situation.adaptable_functions())
    designs: dict[str, str] = {}
    chosen: dict[str, int | None] = {}
    for name, function in situation.functions.items():
        if function.designs:
            design = _first(
                situation.designs, situation.selectable_designs(name), name in adaptable
            )
            chosen[str(names["function", name])] = names.get(("function design", design))
            if name in adaptable and design:
                designs[name] = design
    adaptable = set(situation.adaptable_components(designs))
    for name, component in situation.components.items():
        if component.configurations:
            possible = situation.selectable_configurations(name)
            configuration = _first(situation.configurations, possible, name in adaptable)
            chosen[str(names["component", name])] = names.get(("configuration", configuration))
    status = {}
    for (kind, views), now in zip(
        views_of(situation).items(), views_of(base).values(), strict=True
    ):
        for name, view in () if kind == "attribute" else views.items():
            if view.status != now[name].status:
                status[str(names[kind, name])] = str(view.status)
    feasible = [names["action", name] for name in situation.selectable_actions()]
    return {"feasible": feasible, "status": status, "chosen": chosen}


def _first(parts: Mapping[str, Any], possible: Iterable[str], is_adaptable: bool) -> str:
    """Return the part that is selected, or the first by priority if it is adaptable; empty if there is none."""
    views = [parts[name] for name in possible]
    selected = [view.name for view in views if view.is_selected]
    if selected and not is_adaptable:
        return str(selected[0])
    ranks = [(inf if view.priority is None else view.priority, view.name) for view in views]
    return str(min(ranks, default=(0.0, ""))[1])


def cases(kb: KnowledgeBase, names: Names) -> list[dict[str, Any]]:
    """Return what would be feasible if one thing were different: at most 60 cases of values, and 60 of components.

    One value of each interval between thresholds is tried: all values in an interval give the same statuses. Each
    component is supposed to have failed, or to have recovered if it has failed.
    """
    known = []
    for name, value, low, high in list(_intervals(kb))[:_CASES]:
        case = {"attribute": names["attribute", name], "low": plain(low), "high": plain(high)}
        is_now = low <= value < high
        value = value if is_now else _inside(low, high)
        case |= {"value": value, "now": is_now}
        known.append(case | supposed(kb, kb.situation({name: value}), names))
    for name, view in list(kb.components.items())[:_CASES]:
        if view.status is Status.FAILURE:
            verb, situation = "recovered", kb.situation(recovered=[name])
        else:
            verb, situation = "failed", kb.situation(failed=[name])
        case = {"component": names["component", name], "verb": verb}
        known.append(case | supposed(kb, situation, names))
    return known


def _intervals(kb: KnowledgeBase) -> Iterator[tuple[str, float, float, float]]:
    """Yield the intervals between the thresholds of each measured attribute: name, value now, low and high end."""
    turns: defaultdict[str, set[float]] = defaultdict(set)
    for kind, views in views_of(kb).items():
        for view in () if kind == "attribute" else views.values():
            for constraint in view.constraints:
                threshold = constraint.value
                turns[constraint.attribute].add(threshold)
                margin = constraint.element.hysteresis
                if constraint.status is Status.VIOLATED and margin:
                    sign = 1 if constraint.operator in (">=", ">") else -1
                    turns[constraint.attribute].add(float(f"{threshold + sign * margin:.15g}"))
    for name, attribute in kb.attributes.items():
        if turns[name] and attribute.value is not None:
            for low, high in pairwise([-inf, *sorted(turns[name]), inf]):
                yield name, attribute.value, low, high


def _inside(low: float, high: float) -> float:
    """Return a value between two ends, of which one may be infinite."""
    if -inf < low and high < inf:
        return low + (high - low) / 2
    span = max(abs(low if high == inf else high), 1.0) * 0.1
    return low + span if low > -inf else high - span


def level_of(event: Event) -> str:
    """Return how serious an event is: "error", "warning" or "info"."""
    is_failed = event.verb == "component_failed" or "failed" in event.arguments[1:]
    if is_failed or any(change.new is Status.FAILURE for change in event.changes):
        return "error"
    is_vetoed = event.verb == "record_answer" and bool(event.arguments[1])
    is_lost = any(change.new is Status.UNFEASIBLE for change in event.changes)
    return "warning" if is_vetoed or is_lost or event.verb == "note_no_choice" else "info"


_OPPOSITE: Final = {">=": "<", ">": "<=", "<=": ">", "<": ">="}
_NAMED: Final = 3
"""How many elements a link names; it counts the rest."""


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
