"""The knowledge base: facts come in, statuses follow, actions are requested and configurations selected."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

from kb.beginning import past_plan, past_process, past_request, stated
from kb.declarations import text
from kb.elements import Action, Attribute, Changeable, Component, Constraint, Element, Estimation, finite_number
from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.explanation.reasons import why, why_selected
from kb.facts import Fact, MeasurementFact, PlanFact, ProcessFact, RequiredActionFact
from kb.individuals import individual, plain_json
from kb.inference.growth import grown, shrunk
from kb.inference.network import Network, Node, is_steady
from kb.inference.settling import settle
from kb.inference.state import Overlay
from kb.model import Model
from kb.reconfiguration import ReconfigurationPlan, by_whole, planned, reselect
from kb.requests import Reply, RequiredAction, check_result
from kb.situation import Situation, assumptions, told_of
from kb.status import Status
from kb.store.keeping import KEPT, Keeping
from kb.store.recovery import open_store, resume

__all__ = ["KnowledgeBase"]

_BY_TIME: Final = frozenset({"stale", "dwell", "lapse"})

_ENDED: Final = 4
"""How many requests that have ended a plan names as its reason at most."""


class KnowledgeBase(Keeping):
    """What is known about a robot now, and what follows from it.

    Args:
        model: what the robot is made of and can do. It may be amended later: the next question sees it.
        clock: gives the time [s]; times of facts, requests and plans are its. By default that is the time of day, in
            seconds since 1970-01-01 UTC.
        store: a file that keeps what is told; the base continues from what is in it. See `flush` and `close`.
        keep: how many measurements of each attribute the store keeps; the newest.

    Facts may be told from any thread; each call holds the base until what follows from it is inferred.
    """

    def __init__(
        self,
        model: Model,
        *,
        clock: Callable[[], float] = time.time,
        store: str | Path | None = None,
        keep: int = KEPT,
    ) -> None:
        if not isinstance(model, Model):
            raise InvalidValue(f"a knowledge base is made of a kb.Model, not of {model!r}")
        if not callable(clock):
            raise InvalidValue(f"the clock is a function that returns the time in seconds, not {clock!r}")
        if type(keep) is not int or keep < 1:
            raise InvalidValue(f"keep is a whole number of measurements from 1, not {keep!r}")
        past = None if store is None else open_store(model, store, keep)
        super().__init__(Network(model), clock, past, keep)
        self.model = model
        self._open: dict[str, RequiredAction] = {}
        self._history: list[RequiredAction] = []
        self._plans: list[ReconfigurationPlan] = []
        self._open_plans: list[ReconfigurationPlan] = []
        self._ended: deque[str] = deque(maxlen=_ENDED)
        self._ended_at: tuple[float, int] | None = None
        if past and not past.store.is_new:
            resume(self, past.facts, clock())
            self._look_at_the_clock()
        elif model.facts:
            self._begin(clock())
        self._begin_to_save()
        model.watch(self)

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until all that was told by now is on disk; returns whether it is.

        Args:
            timeout: how long to wait at most [s].

        Raises:
            KnowledgeBaseError: a subscriber asks for it, which holds the base while the writer needs that.
        """
        if self._store is not None:
            self._check_may_wait()
        return super().flush(timeout)

    def close(self) -> None:
        """Save what is left and give the store back: it can still be asked, but not told; see `flush`."""
        if self._store is not None:
            self._check_may_wait()
        with self._lock:
            self._is_closed = self._store is not None
        super().close()

    def request_action(
        self, action: str, preference: str | Mapping[str, float] | None = None, *, cause: int | None = None
    ) -> Reply:
        """Ask that the robot be configured for an action; refused, with the reason, while it is unfeasible.

        Args:
            action: its name.
            preference: name of the attribute to favour when a configuration is chosen for it, or the weight of each
                of several.
            cause: number of the event that led to it; without one, that which ended another action at this instant, or
                the latest that made an action feasible or unfeasible.
        """
        node = self.actions.node(action)
        action = node.name
        preference = self._preference(preference)
        with self._lock:
            self._check_open()
            now = self._clock()
            if action in self._open:
                return Reply(True, f"{action} is required already")
            if self._state.status[node.index] is Status.UNFEASIBLE:
                return Reply(False, why(self._state, node, now))
            if cause is None:
                ended, number = self._ended_at or (None, None)
                cause = number if ended == now else self._feasibility_changed
            self._open[action] = RequiredAction(action, preference, now, cause=cause)
            self._history.append(self._open[action])
            self._journal.enter(now, self._known, (), [self._open[action]])
            self._known.requested[node.index] = True
            told = (action, preference)
            self._tell(now, "request_action", told, node, lambda: f"{action} is requested", cause=cause)
            return Reply(True, f"{action} is required")

    def cancel_action(
        self, action: str, result: str = "abandoned", reason: str = "", *, cause: int | None = None
    ) -> None:
        """Say that an action is no longer required, and how it ended; nothing happens if it is not required.

        Args:
            action: its name.
            result: "completed", "failed" or "abandoned".
            reason: why it ended so, in words; for those who listen and for the history.
            cause: number of the event that led to it; without one, that which made the action unfeasible, if it is.
        """
        node = self.actions.node(action)
        action = node.name
        check_result(result)
        text("the reason why an action ends", reason)
        with self._lock:
            self._check_open()
            now = self._clock()
            required = self._open.pop(action, None)
            if required is None:
                return
            required._finish(result, now, reason)
            self._journal.enter(now, self._known, (), [required])
            self._known.requested[node.index] = False
            words = f"{action} is {result}: {reason}" if reason else f"{action} is {result}"
            if reason:
                self._ended.append(words)
            if cause is None and result != "completed" and self._state.status[node.index] is Status.UNFEASIBLE:
                cause = self._changed_by.get(node.index)
            told = (action, result, reason)
            self._ended_at = now, self._tell(now, "cancel_action", told, node, lambda: words, cause=cause)

    def __repr__(self) -> str:
        return f"<KnowledgeBase {self.model.name!r}: {told_of(self._known)}>"

    def situation(
        self,
        measured: Mapping[str, float | None] | None = None,
        /,
        *,
        failed: Iterable[str] = (),
        recovered: Iterable[str] = (),
        requested: Iterable[str] = (),
        **attributes: float | None,
    ) -> Situation:
        """Return what would be if, to be asked the same questions; the facts stay as they are, and nothing is copied.

        Args:
            measured: values by name of attribute, for names that are no Python names; None is "not measured".
            failed: names of components supposed to have failed.
            recovered: names of components supposed not to have.
            requested: names of actions supposed to be required, even if they are unfeasible.
            attributes: values by name of attribute, e.g. `light=0.3`.
        """
        supposed = assumptions(self, measured, attributes, failed, recovered, requested)
        return Situation(self, tuple(supposed))

    @property
    def required_actions(self) -> tuple[RequiredAction, ...]:
        """The actions that are required now, in the order of their requests."""
        with self._lock:
            return tuple(self._open.values())

    @property
    def action_history(self) -> tuple[RequiredAction, ...]:
        """Every action that was ever required, in the order of the requests."""
        with self._lock:
            return tuple(self._history)

    def select(
        self,
        designs: Mapping[str, str] | None = None,
        configurations: Mapping[str, str] | None = None,
        reason: str = "",
        *,
        dry_run: bool = False,
        cause: int | None = None,
    ) -> ReconfigurationPlan | None:
        """Select a design for each function and a configuration for each component named; unselect what is obsolete.

        Args:
            designs: name of the design by name of its function.
            configurations: name of the configuration by name of its component.
            reason: why these, in words, if not by priority; it is kept with what is selected and with the plan.
            dry_run: only return the plan; nothing is selected, and nobody is told.
            cause: number of the event that made it needed; without one, the latest that changed what is chosen for.

        Returns:
            The plan that leads there from the present state; None if there is nothing to do.
        """
        text("the reason of a choice", reason)
        with self._lock:
            self._check_open()
            chosen = [_owned(self.designs.node(name), self.functions.node(of)) for of, name in _pairs(designs)]
            given = [
                _owned(self.configurations.node(name), self.components.node(of)) for of, name in _pairs(configurations)
            ]
            now = self._clock()
            state = Overlay(self._state) if dry_run else self._state
            why_these = why_selected(state, [*chosen, *given], now, reason, self._ended)
            selection = reselect(state, chosen, given)
            if dry_run:
                return planned(state, selection, why_these, now) if selection else None
            if cause is None:
                cause = self._cause_of([*chosen, *given])
            reselected = dict.fromkeys([*selection.reselected, *chosen, *given])
            said = dict(self._known.reasons)
            for node in reselected:
                self._known.give_reason("selected", node, reason if self._known.selected[node.index] else "")
                self._known.give_reason("unselected", node.wholes[0])
            told = (by_whole(chosen), by_whole(given), reason)
            turns = Counter(selection.reselected)  # what is selected and obsolete at once is as it was
            changed = [node for node, count in turns.items() if count % 2]
            selected = self._known.selected
            effects = tuple((one.kind, one.name, selected[one.index]) for one in changed)
            if not selection:
                self._journal.enter(now, self._known, reselected)
                if changed:
                    self._revision += 1
                if not changed and self._known.reasons == said:
                    return None
                words = ", ".join(f"{name} is {'' if is_so else 'not '}selected" for _, name, is_so in effects)
                self._happened(now, "select", told, lambda: words, selection.changes, cause=cause, effects=effects)
                return None
            plan = replace(planned(self._known, selection, why_these, now), cause=cause, number=len(self._plans) + 1)
            self._ended.clear()
            self._plans.append(plan)
            self._open_plans.append(plan)
            self._plan_numbers[plan] = plan.number
            self._journal.enter(now, self._known, reselected, [plan])
            words = str(plan)
            self._happened(
                now, "select", told, lambda: words, selection.changes, cause=cause, plan=plan, effects=effects
            )
            return plan

    def _cause_of(self, chosen: Sequence[Node]) -> int | None:
        """Return the latest event that changed what is chosen for, or any status of what is not plain data."""
        known = [self._changed_by[one.index] for node in chosen for one in node.wholes if one.index in self._changed_by]
        if not chosen:
            known = [self._ended_at[1]] if self._ended_at else list(self._changed_by.values())
        return max(known, default=None)

    @property
    def plans(self) -> tuple[ReconfigurationPlan, ...]:
        """Every plan, in the order in which they were made."""
        with self._lock:
            return tuple(self._plans)

    @property
    def latest_plan(self) -> ReconfigurationPlan | None:
        """The plan that was made last."""
        return self._plans[-1] if self._plans else None

    @property
    def pending_plan(self) -> ReconfigurationPlan | None:
        """The latest plan that has not ended."""
        with self._lock:
            return self._open_plans[-1] if self._open_plans else None

    @property
    def open_plans(self) -> tuple[ReconfigurationPlan, ...]:
        """The plans that have not ended, in the order in which they were made."""
        with self._lock:
            return tuple(self._open_plans)

    def finish_plan(self, plan: ReconfigurationPlan | int, result: str) -> bool:
        """Close a plan; one that completes abandons every other plan that is open.

        Args:
            plan: one of `plans`, or its number.
            result: "completed", "failed" or "abandoned".

        Returns:
            Whether it was open.
        """
        check_result(result)
        with self._lock:
            self._check_open()
            if isinstance(plan, int):
                plan = self._plan(plan)
            if not isinstance(plan, ReconfigurationPlan) or (plan.end is None and plan not in self._open_plans):
                raise KnowledgeBaseError(f"{plan!r} is not a plan of this knowledge base; finish one of kb.plans")
            if plan.end is not None:
                return False
            now = self._clock()
            plan._finish(result, now)
            self._open_plans.remove(plan)
            if result != "failed":  # to make the same plan again at once would be of no use
                self._revision += 1
            others = self._open_plans[:] if result == "completed" else []
            for other in others:
                other._finish("abandoned", now)
                self._open_plans.remove(other)
            self._journal.enter(now, self._known, (), [plan, *others])
            told = (self._plan_numbers[plan], result)
            self._happened(now, "finish_plan", told, lambda: f"{plan} is {result}", cause=plan.cause)
            return True

    def tell(self, event: Event) -> None:
        """Tell an event again; the clock of this base should show its time.

        What time does comes by itself, when its event is told; what is said of the store is nothing to tell.
        """
        if event.verb in _BY_TIME:
            self._look_at_the_clock()
        elif event.number:
            getattr(self, event.verb)(*event.arguments)

    def model_grew(self, added: Iterable[Changeable]) -> None:
        """Take in what was added to the model; the model calls this."""
        added = tuple(added)
        elements = [one for one in added if not isinstance(one, Estimation)]
        with self._lock:
            touched = grown(self._known, elements)
            for constraint in touched:
                if constraint.kind == "constraint" and is_steady(constraint):
                    self._measurements.renew(constraint, self._clock())
            self._amended("declared", added, touched)

    def model_changed(self, element: Changeable) -> None:
        """Take in what was changed in the model; the model calls this."""
        with self._lock:
            if isinstance(element, Estimation):
                self._journal.amended(self._clock(), "changed", [element], self._known, ())
                self._revision += 1
                return
            node = self._network.find(element)
            touched: Sequence[Node] = [node]
            if node.kind in ("constraint", "attribute"):
                self._network.moved(node if node.kind == "attribute" else node.parts[0])
                touched = self._measurements.renew(node, self._clock())
            self._amended("changed", [element], touched)

    def model_shrank(self, removed: Iterable[Changeable]) -> None:
        """Take in what was removed from the model; the model calls this."""
        removed = tuple(removed)
        elements = [one for one in removed if not isinstance(one, Estimation)]
        with self._lock:
            for element in elements:
                if isinstance(element, Action):
                    self.cancel_action(element.name, reason="it is no longer in the model")
                elif isinstance(element, Component):
                    self._in_force.pop(element.name, None)
                elif isinstance(element, Attribute | Constraint):
                    self._measurements.forget(self._network.find(element))
            self._amended("removed", removed, shrunk(self._known, elements))

    def _begin(self, now: float) -> None:
        """Begin with what the model states."""
        facts = self.model.facts
        settle(self._known, [node for fact in facts for node in self._begin_with(fact, now)])
        if self._journal.keeps_measurements:
            measured = [fact for fact in facts if isinstance(fact, MeasurementFact)]
            for fact in sorted(measured, key=lambda one: one.latest):
                self._journal.measured(fact.attribute, fact.value, now if fact.time is None else fact.time, fact.latest)
        self._journal.enter(now, self._known, self._elements(), [*self._history, *self._plans, *self._processes])

    def _begin_with(self, fact: Fact, now: float) -> Sequence[Node]:
        """Take in a fact that the model states; returns the nodes from which to infer."""
        if isinstance(fact, MeasurementFact):
            node, time = self._network.attributes[fact.attribute], now if fact.time is None else fact.time
            if fact.latest:
                return self._measurements.take(node, fact.value, time)
            self._history_of(node).add(time, fact.value)
        elif isinstance(fact, RequiredActionFact):
            self._history.append(past_request(fact, now))
            if self._history[-1].end is None and fact.action not in self._open:
                self._open[fact.action] = self._history[-1]
                node = self._network.actions[fact.action]
                self._known.requested[node.index] = True
                return [node]
        elif isinstance(fact, PlanFact):
            self._plans.append(past_plan(fact, now))
            if self._plans[-1].end is None:
                self._open_plans.append(self._plans[-1])
        elif isinstance(fact, ProcessFact):
            self._processes.append(past_process(fact, now))
        else:
            entered = stated(self._known, fact)
            return [] if entered is None else [entered]
        return []

    def _amended(self, how: str, changed: Sequence[Changeable], touched: Sequence[Node]) -> None:
        elements = [one for one in changed if not isinstance(one, Estimation)]
        text = f"{', '.join(one.name if isinstance(one, Element) else str(one) for one in elements)} {how} in the model"
        written = plain_json(made for one in changed for made in individual(one, self._journal.serials))
        changes = settle(self._known, touched)
        self._journal.amended(self._clock(), how, changed, self._known, touched)
        self._revision += 1
        self._happened(self._clock(), "amend", (how, written), lambda: text, changes)

    def _preference(self, given: str | Mapping[str, float] | None) -> str | Mapping[str, float] | None:
        if not isinstance(given, Mapping):
            return given if given is None else self.attributes.node(given).name
        return MappingProxyType({self.attributes.node(name).name: finite_number(one) for name, one in given.items()})


def _pairs(chosen: Mapping[str, str] | None) -> Iterable[tuple[str, str]]:
    if chosen is not None and not isinstance(chosen, Mapping):
        raise InvalidValue(f"what is selected is given as choice by name of what it is for, not as {chosen!r}")
    return (chosen or {}).items()


def _owned(node: Node, owner: Node) -> Node:
    if node.wholes[0] is not owner:
        raise InvalidValue(f"{node.kind} {node.name!r} is of {node.wholes[0].name!r}, not of {owner.name!r}")
    return node
