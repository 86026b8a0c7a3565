"""The chain of an adaptation, from its cause to what came of it, found in the log of events."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from kb import Event, Status
from missions.engine.adaptations import Adaptation

_OPPOSITE: Final = {">=": "<", ">": "<=", "<=": ">", "<": ">="}
_NAMED: Final = 3
"""How many elements a link names before it counts the rest."""

Names = Mapping[tuple[str, str], int]


def chain_of(
    adaptation: Adaptation,
    events: Sequence[Event],
    task_plans: Iterable[Any],
    names: Names,
    nodes: Mapping[int, Sequence[int]],
) -> list[dict[str, Any]]:
    """Return the links of the chain in order of cause and effect.

    Elements are given by indices, by kind and name; behaviours by the index of the action that they are about.
    """
    links: list[dict[str, Any]] = []

    def link(time: float, what: str, words: str, elements: Iterable[int] = (), event: int | None = None) -> None:
        about = list(dict.fromkeys(elements))
        uids = [uid for index in about for uid in nodes.get(index, ())]
        links.append({"t": time, "what": what, "words": words, "event": event, "elements": about, "nodes": uids})

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
            link(event.time, "status", words, [names[one.kind, one.name] for one in changed], event.number)
    start, plan = adaptation.news_s - 1e-9, None
    for one in task_plans:
        if start <= one.at_s <= adaptation.at_s and (one.cause is None or one.cause in adaptation.events or not news):
            plan = one
    if plan is not None:
        steps = ", then ".join(dict.fromkeys(step.action or step.schema for step in plan.steps))
        found = f"replanned: {steps}" if plan.outcome.is_solved else f"no plan: {plan.outcome}"
        link(plan.at_s, "replan", found, event=plan.cause)
    for verb, action, words in (
        ("cancel_action", adaptation.before, "stopped"),
        ("request_action", adaptation.action, "requested"),
    ):
        made = [one for one in events if one.verb == verb and one.subject == action and start <= one.time]
        if action and made:
            what = "end" if verb == "cancel_action" else "request"
            link(made[-1].time, what, f"{action} {words}", [names["action", action]], made[-1].number)
    for words, done in adaptation.plans:
        number = next((one.number for one in reversed(events) if one.plan is done), None)
        elements = [names["component", name] for name in (*done.deactivate, *done.activate)]
        elements += [names["configuration", name] for name in done.parameters]
        link(done.start, "plan", words, elements, number)
    if adaptation.reaction_s is not None:
        link(adaptation.in_force_s, "force", f"in force {adaptation.reaction_s:.2f} s after the news")
    order = ["news", "status", "replan", "end", "request", "plan", "force"]
    return sorted(links, key=lambda one: (one["t"], order.index(one["what"])))


def _news(event: Event) -> str:
    """Say what was news: a measurement beside the threshold that it has crossed."""
    for change in event.changes:
        if event.verb == "measure" and change.kind == "constraint" and " just " not in event.text:
            _, operator, threshold = change.name.split(" ", 2)
            shown = operator if change.new is not Status.VIOLATED else _OPPOSITE.get(operator, operator)
            return f"{event.text.replace(' is ', ' ', 1)} {shown} {threshold}"
    return event.text


def _subjects(event: Event, names: Names) -> list[int]:
    kind = "attribute" if event.verb in ("measure", "stale", "dwell") else "component"
    found = [names[kind, event.subject]] if (kind, event.subject) in names else []
    return found + [names[one.kind, one.name] for one in event.changes if one.kind == "constraint"]


def _telling(event: Event) -> list[Any]:
    """Return the changes that say most: those of actions that can be done or not, else of what can be chosen or not."""
    turned = [one for one in event.changes if (one.old is Status.UNFEASIBLE) != (one.new is Status.UNFEASIBLE)]
    actions = [one for one in turned if one.kind == "action"]
    others = [one for one in event.changes if one.kind not in ("constraint", "action")]
    return actions or [one for one in turned if one.kind != "constraint"] or others
