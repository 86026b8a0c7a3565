"""The knowledge base: facts come in, statuses follow, actions are requested and configurations selected."""

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping

from kb.declarations import parameters as checked_parameters
from kb.diagnostics import DiagnosticProblem, Measurement, read_diagnostics
from kb.elements import Constraint, Element, Parameters, finite_number
from kb.events import Event, EventKind, StatusChange
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.explanation import explain, shortest, why_selected
from kb.inference import Change, Network, Node, State, settle
from kb.model import Model
from kb.questions import ELEMENTS, Questions
from kb.reconfiguration import ReconfigurationPlan, reselect
from kb.requests import Reply, RequiredAction, check_result
from kb.status import STATUSES, Status
from kb.views import ElementView

__all__ = ["KnowledgeBase"]

_log = logging.getLogger(__name__)


class KnowledgeBase(Questions):
    """What is known about a robot now, and what follows from it.

    Args:
        model: what the robot is made of and can do.
        clock: gives the time [s]; times of facts, requests and plans are its.

    Facts may be told from any thread; each call holds the base until what follows from it is inferred.
    """

    def __init__(self, model: Model, *, clock: Callable[[], float] = time.time) -> None:
        if not isinstance(model, Model):
            raise InvalidValue(f"a knowledge base is made of a kb.Model, not of {model!r}")
        if not callable(clock):
            raise InvalidValue(f"the clock is a function that returns the time in seconds, not {clock!r}")
        network = Network(model)
        super().__init__(network, State(network), clock)
        self.model = model
        self._subscribers: list[Callable[[Event], None]] = []
        self._events: deque[Event] = deque()
        self._open: dict[str, RequiredAction] = {}
        self._history: list[RequiredAction] = []
        self._plans: list[ReconfigurationPlan] = []
        self._open_plans: list[ReconfigurationPlan] = []
        self._rejected = 0
        self._revision = 0

    # facts

    def measure(self, attribute: str, value: float) -> None:
        """Tell that an attribute was measured just now.

        Raises:
            UnknownName: no such attribute.
            InvalidValue: not a finite number; the facts are as they were.
        """
        node = self.attributes.node(attribute)
        number = value if type(value) is float and math.isfinite(value) else _measured(attribute, value)
        with self._lock:
            now = self._clock()
            self._state.value[node.index] = number
            self._state.time[node.index] = now
            self._told(EventKind.MONITORING_DATA, now, node, lambda: _reading(node, number), plain=True)

    def component_failed(self, component: str) -> None:
        """Tell that a component has failed."""
        self._report(component, failed=True)

    def component_recovered(self, component: str) -> None:
        """Tell that a component has not failed, or no longer."""
        self._report(component, failed=False)

    def component_active(self, component: str, active: bool) -> None:
        """Tell whether a component is running."""
        node = self.components.node(component)
        running = _yes("active", active)
        with self._lock:
            if self._state.active[node.index] == running:
                return
            now = self._clock()
            self._state.active[node.index] = running
            words = "active" if running else "inactive"
            self._told(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    def component_configured(self, component: str, parameters: Parameters) -> None:
        """Tell which parameters a component was given; see `parameters_in_force` of its view."""
        node = self.components.node(component)
        with self._lock:
            self._in_force[node.name] = dict(checked_parameters(node.name, parameters))

    def receive(self, diagnostics: object) -> tuple[DiagnosticProblem, ...]:
        """Take in a DiagnosticArray; see `kb.diagnostics` for the forms in which it may come.

        Returns:
            What could not be used, and why; all the rest has been taken in. These are logged and counted in
            `rejected` too.
        """
        problems = []
        for reading in read_diagnostics(diagnostics):
            if isinstance(reading, DiagnosticProblem):
                problems.append(reading)
                continue
            try:
                if isinstance(reading, Measurement):
                    self.measure(reading.attribute, reading.value)
                else:
                    self._report(reading.component, reading.failed)
            except KnowledgeBaseError as error:
                problems.append(DiagnosticProblem(reading[0], reading.written, str(error)))
        for problem in problems:
            _log.warning("diagnostics: %s", problem)
        with self._lock:
            self._rejected += len(problems)
        return tuple(problems)

    def assert_status(self, element: ElementView | Element | str, status: Status | str) -> None:
        """State an element's status outright; it stands in place of the inferred one until it is retracted."""
        try:
            wanted = Status(status)
        except ValueError:
            known = ", ".join(repr(str(one)) for one in Status)
            raise InvalidValue(f"{status!r} is no status; a status is one of {known}") from None
        self._assert_status(element, wanted)

    def retract_status(self, element: ElementView | Element | str) -> None:
        """Take back an asserted status; the inferred one holds again."""
        self._assert_status(element, None)

    def assert_required(self, element: ElementView | Element | str, required: bool | None) -> None:
        """State that an element is required; False or None takes that back and hides no inferred requirement."""
        with self._lock:
            node = self._node(element, ("action", "function", "component"), unique=True)
            now = self._clock()
            self._state.asserted_required[node.index] = required is not None and _yes("required", required)
            words = "asserted required" if required else "no longer asserted required"
            self._told(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    def assert_selected(self, element: ElementView | Element | str, selected: bool | None) -> None:
        """State that a design or configuration is the selected one, or is not."""
        with self._lock:
            node = self._node(element, ("function design", "configuration"), unique=True)
            now = self._clock()
            self._state.selected[node.index] = selected is not None and _yes("selected", selected)
            words = "selected" if selected else "not selected"
            self._told(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    # actions

    def request_action(self, action: str, preference: str | None = None) -> Reply:
        """Ask that the robot be configured for an action; refused, with the reason, while it is unfeasible.

        Args:
            action: its name.
            preference: name of the attribute to favour when a configuration is chosen for it.
        """
        node = self.actions.node(action)
        action = node.name
        if preference is not None:
            preference = self.attributes.node(preference).name
        with self._lock:
            now = self._clock()
            if action in self._open:
                return Reply(True, f"{action} is required already")
            if self._state.status[node.index] is Status.UNFEASIBLE:
                return Reply(False, str(explain(self._state, node, now)))
            self._open[action] = RequiredAction(action, preference, now)
            self._history.append(self._open[action])
            self._state.requested[node.index] = True
            self._told(EventKind.ACTION_UPDATE, now, node, lambda: f"{action} is requested")
            return Reply(True, f"{action} is required")

    def cancel_action(self, action: str, result: str = "abandoned", reason: str = "") -> None:
        """Say that an action is no longer required, and how it ended; nothing happens if it is not required.

        Args:
            action: its name.
            result: "completed", "failed" or "abandoned".
            reason: why it ended so, in words; for those who listen and for the history.
        """
        node = self.actions.node(action)
        action = node.name
        check_result(result)
        with self._lock:
            now = self._clock()
            required = self._open.pop(action, None)
            if required is None:
                return
            required._finish(result, now, reason)
            self._state.requested[node.index] = False
            words = f"{action} is {result}: {reason}" if reason else f"{action} is {result}"
            self._told(EventKind.ACTION_UPDATE, now, node, lambda: words)

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

    # configurations

    def select(
        self, designs: Mapping[str, str] | None = None, configurations: Mapping[str, str] | None = None
    ) -> ReconfigurationPlan | None:
        """Select a design for each function and a configuration for each component named; unselect what is obsolete.

        Args:
            designs: name of the design by name of its function.
            configurations: name of the configuration by name of its component.

        Returns:
            The plan that leads there from the present state; None if there is nothing to do.
        """
        with self._lock:
            chosen = [_owned(self.designs.node(name), self.functions.node(of)) for of, name in _pairs(designs)]
            given = [
                _owned(self.configurations.node(name), self.components.node(of)) for of, name in _pairs(configurations)
            ]
            now = self._clock()
            reason = why_selected(self._state, [*chosen, *given], now)
            selection = reselect(self._state, chosen, given)
            if not selection:
                return None
            activate, deactivate, parameters, changes = selection
            plan = ReconfigurationPlan(activate, deactivate, parameters, reason, now)
            self._plans.append(plan)
            self._open_plans.append(plan)
            self._publish(Event(EventKind.RECONFIGURATION_PLAN, now, "", str(plan), _status_changes(changes), plan))
            return plan

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

    def finish_plan(self, plan: ReconfigurationPlan, result: str) -> bool:
        """Close a plan; one that completes abandons every other plan that is open.

        Args:
            plan: one of `plans`.
            result: "completed", "failed" or "abandoned".

        Returns:
            Whether it was open.
        """
        check_result(result)
        with self._lock:
            if not isinstance(plan, ReconfigurationPlan) or (plan.end is None and plan not in self._open_plans):
                raise KnowledgeBaseError(f"{plan!r} is not a plan of this knowledge base; finish one of kb.plans")
            if plan.end is not None:
                return False
            now = self._clock()
            plan._finish(result, now)
            self._open_plans.remove(plan)
            if result != "failed":  # to make the same plan again at once would be of no use
                self._revision += 1
            if result == "completed":
                for other in self._open_plans:
                    other._finish("abandoned", now)
                self._open_plans.clear()
            return True

    # telling others

    @property
    def rejected(self) -> int:
        """How many parts of diagnostics could not be used so far."""
        return self._rejected

    @property
    def revision(self) -> int:
        """Grows whenever a fact changed that can matter to a planner: a measurement only if a status changed by it."""
        return self._revision

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Have a function called with every event, in order; returns how to stop that.

        It is called by the thread that told, which holds the base meanwhile: it may ask and tell, but must not wait
        for another thread that does. What it raises is logged and reaches nobody else.
        """
        if not callable(callback):
            raise InvalidValue(f"a subscriber is called with each event; {callback!r} cannot be called")
        self._subscribers.append(callback)

        def unsubscribe() -> None:
            if callback in self._subscribers:
                self._subscribers.remove(callback)

        return unsubscribe

    def _report(self, component: str, failed: bool) -> None:
        node = self.components.node(component)
        with self._lock:
            now = self._clock()
            retracts = not failed and self._state.asserted[node.index] is Status.FAILURE
            if retracts:
                self._state.asserted[node.index] = None
            elif self._state.failed[node.index] == failed:
                return
            self._state.failed[node.index] = failed
            words = "has failed" if failed else "is recovered"
            self._told(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} {words}")

    def _assert_status(self, element: ElementView | Element | str, status: Status | None) -> None:
        with self._lock:
            node = self._node(element, ELEMENTS, unique=True)
            if status is not None and status not in STATUSES[node.kind]:
                known = ", ".join(STATUSES[node.kind])
                raise InvalidValue(f"a {node.kind} is never {status!s}; it can be {known}")
            now = self._clock()
            self._state.asserted[node.index] = status
            words = f"asserted {status}" if status else "no longer asserted"
            self._told(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    def _told(self, kind: EventKind, now: float, node: Node, text: Callable[[], str], plain: bool = False) -> None:
        """Infer what follows from a changed fact and publish it; a plain fact matters only if a status changed."""
        changes = settle(self._state, (node,))
        if changes or not plain:
            self._revision += 1
        if self._subscribers:
            self._publish(Event(kind, now, node.name, text(), _status_changes(changes)))

    def _publish(self, event: Event) -> None:
        self._events.append(event)
        if len(self._events) > 1:
            return  # told by a subscriber: it is published after the event that the subscriber is hearing
        while self._events:
            for subscriber in tuple(self._subscribers):
                try:
                    subscriber(self._events[0])
                except Exception:
                    _log.exception("a subscriber failed on %r", self._events[0].text)
            self._events.popleft()


def _status_changes(changes: Iterable[Change]) -> tuple[StatusChange, ...]:
    return tuple(StatusChange(node.kind, node.name, old, new) for node, old, new in changes)


def _reading(attribute: Node, value: float) -> str:
    bounds = [one.element.value for one in attribute.constraints if isinstance(one.element, Constraint)]
    return f"{attribute.name} is {shortest(value, bounds)}"


def _pairs(chosen: Mapping[str, str] | None) -> Iterable[tuple[str, str]]:
    if chosen is not None and not isinstance(chosen, Mapping):
        raise InvalidValue(f"what is selected is given as choice by name of what it is for, not as {chosen!r}")
    return (chosen or {}).items()


def _yes(what: str, value: object) -> bool:
    if isinstance(value, bool):
        return value
    raise InvalidValue(f"{what} is True or False, not {value!r}")


def _measured(attribute: str, value: object) -> float:
    try:
        return finite_number(value)
    except InvalidValue as error:
        raise InvalidValue(f"{attribute} cannot be measured as {value!r}: {error}") from None


def _owned(node: Node, owner: Node) -> Node:
    if node.wholes[0] is not owner:
        raise InvalidValue(f"{node.kind} {node.name!r} is of {node.wholes[0].name!r}, not of {owner.name!r}")
    return node
