"""The knowledge base as plain data for a page: elements, reasons, what-if cases, causes."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice, pairwise
from math import inf, isfinite
from typing import Any, Final

from kb import Event, KnowledgeBase, Situation, Status
from kb.planning import Choice, choice_by_priority
from missions.engine.adaptations import Adaptation
from missions.views.output import plain

Names = Mapping[tuple[str, str], int]
"""The number of an element, by kind and name."""
Base = KnowledgeBase | Situation
_CASES: Final = 60
_NAMED: Final = 3
"""How many elements a link names; it counts the rest."""
_ORDER: Final = ("news", "status", "replan", "end", "request", "plan", "force")
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
    """Numbers the elements of a knowledge base.

    An element keeps its number when the model is amended.

    Attributes:
        names: the number of each element that is there now, by kind and name.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.names: dict[tuple[str, str], int] = {}
        self._kb = kb
        self._numbers: dict[Any, int] = {}
        self._views: dict[int, tuple[str, Any]] = {}

    def describe(self, units: Mapping[str, str]) -> Iterator[tuple[int, dict[str, Any] | None]]:
        """Yield each element as plain data that refers to others by number.

        None for one that is gone.
        """
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
                data["constraints"] = [
                    self._numbers[constraint.element] for constraint in view.constraints
                ]
                data |= self._relations(kind, view)
            yield number, data
        for number in sorted(before - set(self._views)):
            yield number, None

    def standing(self, kinds: Collection[str]) -> Iterator[tuple[int, str, str, bool | str]]:
        """Yield the facts of each element now: its number, its kind, a track of the page, a value.

        Args:
            kinds: the kinds of elements whose statuses may have changed; other statuses are left
                out.
        """
        for number, (kind, view) in self._views.items():
            if kind in kinds and kind != "attribute":
                yield number, kind, "status", str(view.status)
            for track, fact in _FACTS[kind].items():
                yield number, kind, track, getattr(view, fact)

    def explain(self, number: int) -> dict[str, Any]:
        """Return the reason for an element's status, its remedies, and the choice for its owner."""
        kind, view = self._views[number]
        explained = self._kb.explain(view)
        rows = {
            "why": explained.sentence,
            "help": [str(remedy) for remedy in explained.remedies] or None,
        }
        return rows if kind not in _CHOICES else rows | self.choice(number)

    def choice(self, number: int) -> dict[str, Any]:
        """Return why a function or component has the design or configuration that it has.

        Empty if it has none.
        """
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
        """Return the function of a design or the component of a configuration.

        None for other elements.
        """
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
    """Return what a situation makes feasible, what is chosen there, and which statuses differ."""
    with situation.reading() as state:
        choice = choice_by_priority(state) or Choice({}, {})
    chosen: dict[str, int | None] = {}
    for name, function in situation.functions.items():
        if function.designs:
            design = choice.designs.get(name) or _selected(situation.designs, function.designs)
            chosen[str(names["function", name])] = names.get(("function design", design))
    for name, component in situation.components.items():
        parts = component.configurations
        if parts:
            part = choice.configurations.get(name) or _selected(situation.configurations, parts)
            chosen[str(names["component", name])] = names.get(("configuration", part))
    views_now = views_of(base)
    status = {}
    for kind, views in views_of(situation).items():
        for name, view in () if kind == "attribute" else views.items():
            if view.status != views_now[kind][name].status:
                status[str(names[kind, name])] = str(view.status)
    feasible = [names["action", name] for name in situation.selectable_actions()]
    return {"feasible": feasible, "status": status, "chosen": chosen}


def _selected(views: Mapping[str, Any], parts: Iterable[str]) -> str:
    """Return the part that is selected and not unfeasible; empty if there is none."""
    for name in parts:
        if views[name].is_selected and views[name].status is not Status.UNFEASIBLE:
            return name
    return ""


def cases(kb: KnowledgeBase, names: Names) -> list[dict[str, Any]]:
    """Return what would be feasible if one value or one component were different.

    One value of each interval between thresholds is tried: all values in an interval give the same
    statuses. Each component is supposed to have failed, or to have recovered if it has failed.
    """
    tried: list[dict[str, Any]] = []
    for name, now, low, high in islice(_intervals(kb), _CASES):
        is_now = low <= now < high
        value = now if is_now else _inside(low, high)
        case = {"attribute": names["attribute", name], "low": plain(low), "high": plain(high)}
        case |= {"value": value, "now": is_now}
        tried.append(case | supposed(kb, kb.situation({name: value}), names))
    for name, component in islice(kb.components.items(), _CASES):
        is_failed = component.status is Status.FAILURE
        verb = "recovered" if is_failed else "failed"
        situation = kb.situation(recovered=[name]) if is_failed else kb.situation(failed=[name])
        case = {"component": names["component", name], "verb": verb}
        tried.append(case | supposed(kb, situation, names))
    return tried


def _intervals(kb: KnowledgeBase) -> Iterator[tuple[str, float, float, float]]:
    """Yield the intervals between the thresholds of each attribute: name, value now, low, high."""
    turns: defaultdict[str, set[float]] = defaultdict(set)
    for kind, views in views_of(kb).items():
        for view in () if kind == "attribute" else views.values():
            for constraint in view.constraints:
                margin = constraint.element.hysteresis
                if constraint.status is not Status.VIOLATED:
                    margin = 0.0
                elif constraint.operator in ("<=", "<"):
                    margin = -margin
                turns[constraint.attribute].add(float(f"{constraint.value + margin:.15g}"))
    for name, attribute in kb.attributes.items():
        if turns[name] and attribute.value is not None:
            for low, high in pairwise([-inf, *sorted(turns[name]), inf]):
                yield name, attribute.value, low, high


def _inside(low: float, high: float) -> float:
    """Return a value between two ends, of which one may be infinite."""
    if isfinite(low) and isfinite(high):
        return low + (high - low) / 2
    end = low if isfinite(low) else high
    span = max(abs(end), 1.0) * 0.1
    return end + span if isfinite(low) else end - span


def level_of(event: Event) -> str:
    """Return how serious an event is: "error", "warning" or "info"."""
    is_failed = event.verb == "component_failed" or "failed" in event.arguments[1:]
    if is_failed or any(change.new is Status.FAILURE for change in event.changes):
        return "error"
    is_vetoed = event.verb == "record_answer" and bool(event.arguments[1])
    is_lost = any(change.new is Status.UNFEASIBLE for change in event.changes)
    return "warning" if is_vetoed or is_lost else "info"


# -------------------------------------------------------------------- from cause to effect


def chain_of(
    adaptation: Adaptation,
    events: Sequence[Event],
    task_plans: Iterable[Any],
    names: Names,
    nodes: Mapping[int, Sequence[int]],
) -> list[dict[str, Any]]:
    """Return the links of the chain from the cause of an adaptation to its effect, in that order.

    `names` has the number of an element by kind and name, `nodes` the ids of the behaviours that
    use an action by the number of the action.
    """
    links: list[dict[str, Any]] = []

    def link(
        time: float, what: str, words: str, elements: Iterable[int] = (), event: int | None = None
    ) -> None:
        unique = list(dict.fromkeys(elements))
        uids = [uid for number in unique for uid in nodes.get(number, ())]
        shown = {"t": time, "what": what, "words": words, "event": event}
        links.append({**shown, "elements": unique, "nodes": uids})

    start = adaptation.news.time - 1e-9
    causes = [event for event in events if event.number in adaptation.news.events]
    for event in causes:
        link(event.time, "news", event.text, _subjects(event, names), event.number)
        changes = _main_changes(event)
        if changes:
            words = ", ".join(f"{change.name} {change.new}" for change in changes[:_NAMED])
            if len(changes) > _NAMED:
                words += f" and {len(changes) - _NAMED} more"
            numbers = [names[change.kind, change.name] for change in changes]
            link(event.time, "status", words, numbers, event.number)
    if not causes:
        link(adaptation.news.time, "news", adaptation.trigger)
    for plan in list(task_plans)[::-1]:
        is_for_it = not causes or plan.cause is None or plan.cause in adaptation.news.events
        if start <= plan.at_s <= adaptation.at_s and is_for_it:
            steps = ", then ".join(dict.fromkeys(step.action or step.schema for step in plan.steps))
            is_solved = plan.outcome.is_solved
            words = f"replanned: {steps}" if is_solved else f"no plan: {plan.outcome}"
            link(plan.at_s, "replan", words, event=plan.cause)
            break
    decisions = {("cancel_action", adaptation.before), ("request_action", adaptation.action)}
    for event in events:
        is_in_time = start <= event.time <= adaptation.at_s + 1e-9
        if is_in_time and (event.verb, event.subject) in decisions:
            is_end = event.verb == "cancel_action"
            words = f"{event.subject} {'stopped' if is_end else 'requested'}"
            elements = [names["action", event.subject]]
            link(event.time, "end" if is_end else "request", words, elements, event.number)
    for words, done in adaptation.plans:
        number = next((event.number for event in reversed(events) if event.plan is done), None)
        elements = [names["component", name] for name in (*done.deactivate, *done.activate)]
        elements += [names["configuration", name] for name in done.parameters]
        link(done.start, "plan", words, elements, number)
    if adaptation.reaction_s is not None:
        words = f"in force {adaptation.reaction_s:.2f} s after the news"
        link(adaptation.in_force_s, "force", words)
    return sorted(links, key=lambda link: (link["t"], _ORDER.index(link["what"])))


def _subjects(event: Event, names: Names) -> list[int]:
    kind = "attribute" if event.verb in ("measure", "stale", "dwell") else "component"
    subjects = [names[kind, event.subject]] if (kind, event.subject) in names else []
    for change in event.changes:
        if change.kind == "constraint":
            subjects.append(names[change.kind, change.name])
    return subjects


def _main_changes(event: Event) -> list[Any]:
    """Return the actions that became feasible or unfeasible, else all changed elements."""
    changes = [change for change in event.changes if change.kind != "constraint"]
    actions = [change for change in changes if change.kind == "action"]
    turned = [change for change in actions if Status.UNFEASIBLE in (change.old, change.new)]
    return turned or [change for change in changes if change.kind != "action"]
