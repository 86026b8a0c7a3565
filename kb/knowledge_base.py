"""The knowledge base: it records facts, and answers what follows from them.

Every method that records something decides first, without changing anything. Then it records one
event, in a single step: from there on the event is in. Then it applies the event. Applying only
assigns, so that whoever comes next can repeat what an interrupt cut short.
"""

import logging
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import wraps
from itertools import starmap
from math import inf, isfinite
from operator import attrgetter
from pathlib import Path
from threading import RLock
from types import MappingProxyType
from typing import Any, Final, Literal, TypeVar
from weakref import WeakSet, finalize

from kb import elements, views
from kb.debounce import NEVER
from kb.diagnostics import DiagnosticProblem, DiagnosticRules, record_diagnostics
from kb.elements import (
    Parameters,
    finite_number,
    flag,
    status_of,
    table,
    weights,
    whole,
)
from kb.events import RECORDS, Event, Publisher, StatusChange
from kb.exceptions import InvalidValue, KnowledgeBaseError, Unselectable
from kb.explain import reading as reading_in_words
from kb.explain import staleness, why, why_selected
from kb.forecast import Forecaster, feasible_until
from kb.model import Model
from kb.network import Network, Node
from kb.ontology import Answer, Ontology
from kb.records import (
    RESULTS,
    Attempt,
    HistoryView,
    Log,
    Process,
    ReconfigurationPlan,
    Records,
    Reply,
    RequiredAction,
    VetoAnswer,
    check_result,
)
from kb.situations import (
    ELEMENTS,
    ElementLike,
    Situation,
    outline,
    resolve,
)
from kb.state import KEPT, Reason, State
from kb.status import Status
from kb.store import Store

_log = logging.getLogger(__name__)
_CLOCK_SLACK_S: Final = 1.0
"""How far a clock may go back: clocks are corrected, and threads may be overtaken [s]."""
_REPLAYABLE: Final[dict[str, Callable[..., object]]] = {}
"""The method that records an event again, by its verb."""
_LOCKS: Final[WeakSet[Any]] = WeakSet()
"""The locks of all bases: one that another thread holds at a fork would stay held in the child."""
_held_locks: list[Any] = []

MethodT = TypeVar("MethodT", bound=Callable[..., Any])


def _hold_locks() -> None:
    for lock in tuple(_LOCKS):
        lock.acquire()
        _held_locks.append(lock)


def _release_locks() -> None:
    while _held_locks:
        _held_locks.pop().release()


os.register_at_fork(
    before=_hold_locks, after_in_parent=_release_locks, after_in_child=_release_locks
)


def _update(method: MethodT) -> MethodT:
    """Make a method record facts: hold the lock, record what is due, run it, call subscribers.

    The clock and the subscribers are foreign code, which may wait for another thread. So they are
    called without the lock.
    """

    @wraps(method)
    def updating(self: "KnowledgeBase", *args: object, **kwargs: object) -> object:
        now = self._read_clock()
        with self._lock:
            if self.store is not None:
                self.store.check_open()
            self._prepare(now)
            result = method(self, *args, **kwargs)
            last = self.log.last
        if self._publisher.subscribers or self.store is not None:
            self._publish(last)
        return result

    _REPLAYABLE[method.__name__.removeprefix("_")] = updating
    return updating  # type: ignore[return-value]  # it has the same signature


class Reading:
    """A context manager that gives a state while it holds a lock.

    Python handles a signal between two instructions, never within a C function. So one C call
    takes the lock and notes that, and another one gives it back: no interrupt leaves it taken.
    """

    def __init__(self, lock: Any, state: Callable[[], State]) -> None:  # noqa: ANN401  # an RLock has no type
        self._lock = lock
        self._state = state

    def __enter__(self) -> State:
        taken: list[Any] = []
        try:
            taken.extend(starmap(self._lock.__enter__, ((),)))
            return self._state()
        except BaseException:
            if taken:
                self._lock.__exit__(None, None, None)
            raise

    __exit__ = property(attrgetter("_lock.__exit__"))


class KnowledgeBase:
    """What is known about a robot now, and what follows from it.

    Args:
        model: what the robot is made of and can do. It may change later; the next answer sees it.
        clock: returns the time [s]; facts, requests and plans get their times from it. By default
            it is the time of day, in seconds since 1970-01-01 UTC.
        store: the file that keeps the log; the base continues from it. See `flush` and `close`.
        keep: how many measurements of each attribute are kept, in memory and in the store; the
            newest are.
        is_timed: whether time causes events by itself; False for a replay, in which the recorded
            events of time are replayed in their places, and nowhere else.

    Time does not go back, so that facts keep their order: if the clock goes back up to a second,
    time stands still until the clock has caught up. A clock that goes back further is refused, or
    followed if the attribute `on_clock_set_back` is "follow": then time goes on from where it was,
    and a warning is logged. A `rosa_bt.TreeRunner` sets it for the bases of its tree.

    Facts may be recorded from any thread; each call holds the lock until all that follows is
    inferred. Each fact is in or out: if a call is interrupted, the base answers as if the fact was
    recorded, or as if it was not.

    Attributes:
        model: the model as it is now.
        log: the events, in order; it holds the newest ones.
        history: records that are needed less often.
        store: the file of the log, and its error if it has one; None without a store.
        forecast: predicts attributes, as in `kb.forecast("energy", 30.0)`; see `Forecaster`.
        actions, functions, components, designs, configurations, attributes: read-only views by
            name.
    """

    def __init__(
        self,
        model: Model,
        *,
        clock: Callable[[], float] = time.time,
        store: str | Path | None = None,
        keep: int = KEPT,
        is_timed: bool = True,
    ) -> None:
        if not isinstance(model, Model):
            raise InvalidValue(f"a knowledge base is made of a kb.Model, not of {model!r}")
        if not callable(clock):
            raise InvalidValue(f"clock is a function that returns the time [s], not {clock!r}")
        whole("the number of measurements to keep", keep)
        model.settle()
        self.model = model
        self._clock = clock
        self._set_back_s = 0.0
        self.on_clock_set_back: Literal["refuse", "follow"] = "refuse"
        self._is_timed = is_timed
        self._lock = RLock()
        _LOCKS.add(self._lock)
        self.store = None if store is None else Store(store, model, keep)
        self._state = State(Network(model), keep)
        self._records = Records()
        self._event: Event | None = None  # recorded, and not applied completely
        self._followed: elements.Amended | None = None  # the last change of the model
        self._revision = 0
        self.log = Log(self.reading)
        self._now = self._read_clock()
        self._publisher = Publisher(self.log, self._lock)
        self._reading = Reading(self._lock, self._settled)
        self.forecast = Forecaster(self)
        self.actions = views.Views(self, "actions", views.ActionView)
        self.functions = views.Views(self, "functions", views.FunctionView)
        self.components = views.Views(self, "components", views.ComponentView)
        self.designs = views.Views(self, "designs", views.DesignView)
        self.configurations = views.Views(self, "configurations", views.ConfigurationView)
        self.attributes = views.Views(self, "attributes", views.AttributeView)
        if self.store is not None and not self.store.is_new:
            self._restore(self.store)
        elif model.facts:
            self._begin(model.facts, self._now)
        self.history = HistoryView(self._records, self.reading)
        self._ontology = Ontology(self)
        model.watch(self._follow_model)
        if self.store is not None:
            self.store.start(self.log, self._lock, self._snapshot, self._record_store_message)
            finalize(self, self.store.close)
            self._catch_up_with_time()  # with the events that came due meanwhile

    # ---------------------------------------------------------------- asked

    @property
    def _network(self) -> Network:
        return self._state.network

    def is_feasible(self, action: str) -> bool:
        """Tell whether an action can be done now: its status is not "unfeasible"."""
        state = self._state
        if self.model.pending is None and self._event is None and state.next_due == NEVER:
            node = self._network.actions.get(action)
            status = None if node is None else state.status.get(node)
            if status is not None:  # a single read needs no lock
                return status is not Status.UNFEASIBLE
        return Situation.is_feasible(self, action)

    selectable_actions = Situation.selectable_actions
    selectable_designs = Situation.selectable_designs
    selectable_configurations = Situation.selectable_configurations
    best_configuration = Situation.best_configuration
    adaptable_functions = Situation.adaptable_functions
    adaptable_components = Situation.adaptable_components
    obsolete = Situation.obsolete
    explain = Situation.explain
    why = Situation.why
    explain_choice = Situation.explain_choice
    situation = Situation.situation
    feasible_until = feasible_until

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only.

        Nothing changes within the `with` statement.
        """
        if self.model.pending is not None:
            self.model.settle()
        due = self._state.next_due if self._is_timed else NEVER
        if due != NEVER and not self._publisher.is_held() and due <= self._read_clock():
            self._catch_up_with_time()
        return self._reading

    def __repr__(self) -> str:
        with self.reading() as state:
            return f"<KnowledgeBase {self.model.name!r}: {outline(state)}>"

    def _repr_html_(self) -> str:
        with self.reading() as state:
            rows = [
                (node.kind, node.name, state.status.get(node, state.value.get(node)))
                for node in state.network.present()
            ]
            title = f"{self.model.name}: {outline(state)}"
            return table(title, ("kind", "name", "status or value"), rows)

    @property
    def now(self) -> float:
        """The time by the clock [s]."""
        return self._read_clock()

    @property
    def revision(self) -> int:
        """Grows whenever a fact changes that can matter to a planner.

        A measurement counts only if a status changes.
        """
        self.reading()  # makes the events that are due; a single read needs no lock
        return self._revision

    @property
    def required_actions(self) -> tuple[RequiredAction, ...]:
        """The actions that are required now, in the order of their requests."""
        with self.reading():
            return tuple(self._records.required.values())

    @property
    def plans(self) -> tuple[ReconfigurationPlan, ...]:
        """All plans, in the order in which they were made."""
        with self.reading():
            return tuple(self._records.plans.values())

    @property
    def latest_plan(self) -> ReconfigurationPlan | None:
        """The plan that was made last."""
        return next(reversed(self.plans), None)

    @property
    def pending_plan(self) -> ReconfigurationPlan | None:
        """The latest plan that has not ended."""
        with self.reading():
            return next(reversed(self._records.open_plans.values()), None)

    def query(self, sparql: str, timeout: float = 10.0) -> list[tuple[Answer, ...]]:
        """Answer a SPARQL query over the model, the facts and the statuses that follow from them.

        Args:
            sparql: a SELECT query; the prefixes `:` and `rosa:` stand for the vocabulary of ROSA.
            timeout: how long the query may take [s].

        Returns:
            One tuple for each answer, of numbers, texts, booleans or None; an individual is given
            by its IRI.

        Raises:
            InvalidValue: the text is no query, or the query would change something.
            KnowledgeBaseError: the query did not end within the timeout.
        """
        return self._ontology.query(sparql, timeout)

    @property
    def ontology(self) -> Any:  # noqa: ANN401  # of owlready2, which has no types
        """The model and what is known now as a `World` of owlready2, up to date; read it only.

        It is closed when the knowledge base is gone.
        """
        return self._ontology.world

    # ---------------------------------------------------------------- record facts

    @_update
    def measure(self, attribute: str, value: float) -> None:
        """Record a measurement.

        Raises:
            UnknownName: the model has no such attribute.
            InvalidValue: the value is not a finite number or is outside the attribute's range;
                nothing is recorded.
        """
        node = self._network.attributes[attribute]
        element: Any = node.element
        if not (type(value) is float and isfinite(value) and element.low <= value <= element.high):
            value = element.checked(value, "be measured as")
        words = ""
        if self._publisher.subscribers or self.log.witnesses:
            thresholds = [constraint.element.value for constraint in node.constraints]
            words = f"{attribute} is {reading_in_words(value, thresholds, node)}"
        self._record("measure", node.name, value, words=words)

    @_update
    def component_failed(self, component: str, reason: str = "") -> None:
        """Record that a component has failed.

        Explanations and the store give the reason, in words.
        """
        node = self._network.components[component]
        is_news = reason not in ("", self._state.reason("failed", node).text)
        if is_news or node not in self._state.failed:
            self._record("component_failed", node.name, str(reason))

    @_update
    def component_recovered(self, component: str) -> None:
        """Record that a component works again after a failure."""
        node = self._network.components[component]
        state = self._state
        if node in state.failed or state.asserted.get(node) is Status.FAILURE:
            self._record("component_recovered", node.name)

    @_update
    def component_active(self, component: str, active: bool, reason: str = "") -> None:
        """Record whether a component is running.

        If it is not, explanations give the reason, in words.
        """
        node = self._network.components[component]
        if (node in self._state.active) != flag("active", active, InvalidValue):
            self._record("component_active", node.name, active, str(reason))

    def receive(
        self, diagnostics: object, *, rules: DiagnosticRules | None = None
    ) -> tuple[DiagnosticProblem, ...]:
        """Record the facts in a DiagnosticArray of ROS.

        See `kb.diagnostics` for the forms that are accepted.

        Args:
            diagnostics: the array.
            rules: the meaning of statuses that are not ROSA's own.

        Returns:
            The parts that could not be used, and why; all other parts are recorded. These problems
            are also logged, and counted in `history.rejected`.
        """
        problems = record_diagnostics(self, diagnostics, rules)
        self._records.rejected += len(problems)
        return problems

    @_update
    def assert_status(
        self,
        element: ElementLike,
        status: Status | str,
        reason: str = "",
        until: float | None = None,
    ) -> None:
        """Set an element's status; it replaces the inferred status until it is retracted or lapses.

        Args:
            element: a view, an element of the model, or a name that only one element has.
            status: one that an element of this kind can have.
            reason: why, in words; explanations and the store give it.
            until: when it lapses by itself [s, by the clock of this base], later than now; None or
                `math.inf`: never.
        """
        end = None if until is None or until == inf else finite_number(until)
        node = self._node(element, ELEMENTS)
        wanted = str(status_of(node.kind, status))
        if end is not None and end <= self._now:
            raise InvalidValue(
                f"a status is asserted until later than now, {self._now!r} s by the clock; "
                f"not {until!r}"
            )
        reason = str(reason)
        words = f"{node.name} is asserted {wanted}{Reason(reason, end)}"
        self._record("assert_status", node.ref, wanted, reason, end, words=words)

    @_update
    def retract_status(self, element: ElementLike) -> None:
        """Take back an asserted status; the inferred status holds again."""
        node = self._node(element, ELEMENTS)
        self._record("retract_status", node.ref, words=f"{node.name} is no longer asserted")

    @_update
    def assert_required(self, element: ElementLike, required: bool | None) -> None:
        """State that an element is required.

        False or None takes that back, but not an inferred requirement.
        """
        node = self._node(element, ("action", "function", "component"))
        flag("required", required or False, InvalidValue)
        self._record("assert_required", node.ref, required)

    @_update
    def assert_selected(
        self, element: ElementLike, selected: bool | None, reason: str = ""
    ) -> None:
        """State whether a design or configuration is selected; explanations give the reason."""
        node = self._node(element, ("function design", "configuration"))
        flag("selected", selected or False, InvalidValue)
        self._record("assert_selected", node.ref, selected, str(reason))

    # ---------------------------------------------------------------- record actions and plans

    @_update
    def request_action(
        self,
        action: str,
        preference: str | Mapping[str, float] | None = None,
        *,
        cause: int | None = None,
    ) -> Reply:
        """Request that the robot is configured for an action.

        An unfeasible action is refused, with the reason.

        Args:
            action: name of the action.
            preference: name of the attribute to favour when a configuration is chosen for the
                action, or a mapping from names of attributes to weights.
            cause: number of the event that led to the request; by default the event that ended
                another action at this instant, else the latest event that made an action feasible
                or unfeasible.
        """
        node = self._network.actions[action]
        attributes = self._network.attributes
        wanted: str | Mapping[str, float] | None
        if isinstance(preference, str):
            wanted = attributes[preference].name
        else:
            wanted = weights(preference, attributes)
        if node.name in self._records.required:
            return Reply(True, f"{node.name} is required already")
        if self._state.status[node] is Status.UNFEASIBLE:
            return Reply(False, why(self._state, node, self._now))
        if cause is None:
            cause = self._cause_of_request()
        self._record("request_action", node.name, wanted, cause=cause)
        return Reply(True, f"{node.name} is required")

    @_update
    def cancel_action(
        self, action: str, result: str = "abandoned", reason: str = "", *, cause: int | None = None
    ) -> None:
        """Record that an action is no longer required, and how it ended.

        Nothing happens if it is not required.

        Args:
            action: name of the action.
            result: "completed", "failed" or "abandoned".
            reason: why the action ended in this way, in words; subscribers and the history get it.
            cause: number of the event that led to the end; by default the one that made the action
                unfeasible, if any.
        """
        node = self._network.actions[action]
        check_result(result)
        if node.name not in self._records.required:
            return
        is_unfeasible = self._state.status[node] is Status.UNFEASIBLE
        if cause is None and result != "completed" and is_unfeasible:
            cause = self._state.changed_by.get(node)
        self._record("cancel_action", node.name, result, str(reason), cause=cause)

    @_update
    def select(
        self,
        designs: Mapping[str, str] | None = None,
        configurations: Mapping[str, str] | None = None,
        reason: str = "",
        *,
        dry_run: bool = False,
        cause: int | None = None,
    ) -> ReconfigurationPlan | None:
        """Select a design for each given function, a configuration for each given component.

        Unselect what is obsolete.

        Args:
            designs: maps the name of a function to the name of its design.
            configurations: maps the name of a component to the name of its configuration.
            reason: why these are chosen, in words, if not by priority; it is kept with the
                selection and with the plan.
            dry_run: only return the plan; nothing is selected, and no event is made.
            cause: number of the event that led to the selection; by default the latest event that
                changed one of the functions, components or alternatives.

        Returns:
            The plan that leads from the present state to the selection; None if there is nothing to
            do.

        Raises:
            InvalidValue: a design or configuration is unfeasible now; nothing is selected.
        """
        state = self._state
        network = state.network
        nodes = _chosen(network.designs, network.functions, designs)
        nodes += _chosen(network.configurations, network.components, configurations)
        for node in nodes:
            if state.status[node] is Status.UNFEASIBLE:
                raise Unselectable(f"{node} cannot be selected: {why(state, node, self._now)}")
        if cause is None:
            cause = self._cause_of_choice(nodes)
        words = why_selected(state, nodes, self._now, reason)
        number = next(reversed(self._records.plans), 0) + 1
        flips, plan = state.decide(nodes)
        if plan is not None:
            plan = replace(plan, reason=words, start=self._now, cause=cause, number=number)
        effects = tuple((node.kind, node.name, node not in state.selected) for node in flips)
        if (plan or effects) and not dry_run:
            choice = [MappingProxyType(dict(each or {})) for each in (designs, configurations)]
            self._record("select", *choice, str(reason), cause=cause, effects=effects, plan=plan)
        return plan

    @_update
    def finish_plan(self, plan: ReconfigurationPlan | int, result: str) -> bool:
        """End a plan as "completed", "failed" or "abandoned"; returns whether it was open.

        When a plan completes, all other open plans are abandoned.
        """
        if result not in RESULTS:
            check_result(result)
        record = self._plan_of(plan)
        if record.end is not None:
            return False
        self._record("finish_plan", record.number, result, cause=record.cause)
        return True

    # ---------------------------------------------------------------- record what is done

    @_update
    def component_started(self, component: str, pid: int) -> Process:
        """Record that a process of the operating system was started for a component.

        It need not be active yet.
        """
        self._record("component_started", self._network.components[component].name, int(pid))
        return next(reversed(self._records.processes.values()))

    @_update
    def component_ended(self, component: str, pid: int) -> None:
        """Record that the process of a component with this number has ended."""
        self._record("component_ended", self._network.components[component].name, int(pid))

    @_update
    def record_attempt(
        self,
        plan: ReconfigurationPlan | int,
        component: str,
        operation: str,
        configuration: str | None = None,
        parameters: Parameters | None = None,
        number: int = 1,
    ) -> Attempt:
        """Record that a command is given now; `finish_attempt` records its result.

        Args:
            plan: the plan that gives the command; one of `plans`, or its number.
            component: name of the component that is commanded.
            operation: "activate", "deactivate" or "configure".
            configuration: name of the configuration to set, None if the component is only switched.
            parameters: the parameters to set.
            number: 1 for the first time that the plan gives this command.
        """
        of = self._plan_of(plan).number
        name = self._network.components[component].name
        values = MappingProxyType(dict(parameters or {}))
        self._record("record_attempt", of, name, operation, configuration, values, number)
        return next(reversed(self._records.attempts.values()))

    @_update
    def finish_attempt(self, attempt: Attempt | int, result: str, reason: str = "") -> bool:
        """Record the result of a command.

        Returns False if the attempt has ended already or is unknown.

        The attempt may be given by its serial number; the result is "completed", "failed" or
        "abandoned". When a "configure" command completes, its parameters are in force.
        """
        if result not in RESULTS:
            check_result(result)
        serial = attempt.serial if isinstance(attempt, Attempt) else attempt
        record = self._records.attempts.get(serial)
        if record is None or record.end is not None:
            return False
        self._record("finish_attempt", serial, result, str(reason))
        return True

    @_update
    def record_answer(
        self, plan: ReconfigurationPlan | int, is_vetoed: bool, reason: str = ""
    ) -> VetoAnswer:
        """Record whether a plan was vetoed before its execution, and why."""
        number = self._plan_of(plan).number
        self._record("record_answer", number, bool(is_vetoed), str(reason))
        return next(reversed(self._records.answers.values()))

    # ---------------------------------------------------------------- the log

    def replay(self, event: Event) -> None:
        """Record an event again, e.g. of another base; the clock should show its time.

        Events that the model or the store causes are recorded by this base itself, and so are those
        that time causes, unless the base is not timed. But "stale" is always replayed: an attribute
        may be stale early because its source is gone.

        Raises:
            InvalidValue: the event cannot be replayed; nothing has changed.
        """
        verb = event.verb
        if verb in ("begin", "store") or (self._is_timed and verb in ("dwell", "lapse")):
            self._catch_up_with_time()
            return
        arguments = event.arguments
        if verb in ("stale", "dwell", "lapse"):
            arguments = verb, *arguments
            verb = "replay_due"
        if verb not in _REPLAYABLE:
            raise InvalidValue(f"{event!r} cannot be replayed")
        is_caused = verb in ("request_action", "cancel_action", "select")
        keywords = {"cause": event.cause} if is_caused else {}
        try:
            _REPLAYABLE[verb](self, *arguments, **keywords)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            if isinstance(error, KnowledgeBaseError):
                raise
            raise InvalidValue(f"{verb} cannot be replayed with {arguments!r}: {error}") from None

    def _amend(self, how: str, written: Any) -> None:  # noqa: ANN401  # what JSON holds
        self.model.amend(how, written)

    _REPLAYABLE["amend"] = _amend

    @_update
    def _replay_due(self, verb: str, element: Any, *_: object) -> None:  # noqa: ANN401  # a name or reference
        is_stale = verb == "stale"
        node = self._network.attributes[element] if is_stale else self._network.referred(element)
        if not is_stale or (node in self._state.value and node not in self._state.stale):
            self._record_due(self._now, verb, node)

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call a function with every event from now on, in order.

        Returns a function that ends the subscription.

        The callback runs on a thread that records facts, without the lock, so it may ask and
        record. An exception in it is logged and goes no further.
        """
        return self._publisher.subscribe(callback)

    def flush(self, timeout: float | None = None) -> bool:
        """Wait, at most for a timeout [s], until all events so far are on disk.

        Returns whether they are.
        """
        return self.store is not None and self.store.flush(timeout)

    def close(self) -> None:
        """Save all events and close the store.

        You can still ask what is held in memory, but record nothing more.
        """
        if self.store is not None:
            self.store.close()

    def __reduce__(self) -> Any:  # noqa: ANN401  # never returns
        raise KnowledgeBaseError(
            "a knowledge base holds a lock, a clock and subscribers, so it cannot be copied or "
            "pickled; take kb.situation(), which is a copy of the facts, or give it a store"
        )

    # ---------------------------------------------------------------- recording events

    def _record(
        self,
        verb: str,
        *arguments: object,
        time: float | None = None,
        **details: Any,  # noqa: ANN401  # other fields of an event
    ) -> None:
        """Record an event, which has been decided, and apply it."""
        at = self._now if time is None else time
        self._event = Event(self.log.last + 1, at, verb, arguments, **details)
        self._complete_event()  # from here on it is in

    def _complete_event(self) -> None:
        """Apply the event that is recorded and not applied completely, if there is one."""
        event = self._event
        if event is None:
            return
        if event.verb == "amend":
            self._renew()
        elif event.verb not in RECORDS:
            self._state.apply(event)
        state = self._state
        if state.before:
            event = self._with_changes(event)
        if _matters(event):
            self._revision = event.number
        is_new = self.log.last < event.number
        if event.verb != "measure":
            self._records.apply(event)
        self.log.append(event)
        if event.verb == "finish_attempt" and event.arguments[1] == "completed":
            attempt = self._records.attempts[event.arguments[0]]
            if attempt.operation == "configure":
                component = state.network.components[attempt.component]
                state.parameters[component] = attempt.parameters
        state.before = {}
        self._event = None
        for witness in self.log.witnesses if is_new else ():
            witness(event)

    def _with_changes(self, event: Event) -> Event:
        """Return the event with the statuses that it has changed, and note it as their cause."""
        state = self._state
        is_switched = event.verb == "component_active" and not event.arguments[2]
        is_cause = not (is_switched and self._records.open_plans)  # else a plan has switched it
        changes = []
        changed = [node for node, old in state.before.items() if state.status[node] is not old]
        for node in sorted(changed, key=attrgetter("index")):
            change = StatusChange(node.kind, node.name, state.before[node], state.status[node])
            changes.append(change)
            if is_cause:
                state.changed_by[node] = event.number
            if node.kind == "action" and Status.UNFEASIBLE in change[2:]:
                state.feasibility_changed_by = event.number
        return Event(*event[:4], tuple(changes), *event[5:])

    # ---------------------------------------------------------------- time

    def _read_clock(self) -> float:
        """Return the time by the clock, or that of the last event if that is later [s].

        The clock is foreign code, which may wait for another thread: read it without the lock.
        """
        if self.model.pending is not None:
            self.model.settle()
        last = self.log.time  # before the clock: another thread may record something meanwhile
        now = self._clock()
        is_time = isinstance(now, int | float) and isfinite(now)
        is_set_back = is_time and now + self._set_back_s < last - _CLOCK_SLACK_S
        if is_set_back and self.on_clock_set_back == "follow":
            _log.warning("the clock gives %g s after %g s; time goes on from there", now, last)
            self._set_back_s = last - now  # not added, as several threads may see it
        elif is_set_back or not is_time:
            raise InvalidValue(
                f"the clock gives {now!r} after {last!r} s, and facts keep their order: give the "
                "knowledge base a clock in seconds that is not set back, e.g. time.monotonic; "
                "nothing was recorded"
            )
        return max(now + self._set_back_s, last)

    def _prepare(self, now: float) -> None:
        """Complete what was interrupted, and record what time has caused until now [s]."""
        self._complete_event()
        self._now = now = max(now, self.log.time)
        if self._is_timed and now >= self._state.next_due:
            while (due := self._state.due(now)) is not None:
                self._record_due(*due)

    def _record_due(self, time: float, what: str, node: Node) -> None:
        """Record what time causes, at the instant at which it is due."""
        time = max(time, self.log.time)  # a changed model may make it due in the past
        state = self._state
        if what == "stale":
            words = f"{node.name} {staleness(state.time.get(node), node, time)}"
            self._record(what, node.name, words=words, time=time)
        elif what == "dwell":
            words = f"{node.name} is {state.judged(node, time)[0].status}, after its dwell"
            self._record(what, node.ref, words=words, time=time)
        else:
            status = str(state.asserted.get(node))
            words = f"{node.name} is no longer asserted {status}: its time is over"
            self._record(what, node.ref, status, words=words, time=time)

    def _catch_up_with_time(self) -> None:
        """Record what time has caused until now."""
        now = self._read_clock()
        with self._lock:
            self._prepare(now)
        self._publish()

    def _settled(self) -> State:
        """Return the state, after an interrupted event is completed."""
        self._complete_event()
        return self._state

    def _publish(self, last: int = 0) -> None:
        """Call the subscribers, and wait if the store is too far behind."""
        if self._publisher.subscribers:
            self._publisher.deliver()
        if self.store is not None:
            self.store.proceed(0 if self._publisher.is_held() else last)

    # ---------------------------------------------------------------- the model

    def _begin(self, stated: Sequence[elements.Fact], now: float) -> None:
        """Begin with what the model states."""
        state = self._state
        network = state.network

        def time_of(fact: elements.MeasurementFact) -> tuple[bool, float]:
            return fact.latest, now if fact.time is None else fact.time

        measured = [fact for fact in stated if isinstance(fact, elements.MeasurementFact)]
        measured.sort(key=time_of)
        for number, measurement in enumerate(measured, start=-len(measured)):
            node = network.attributes[measurement.attribute]
            _, time = time_of(measurement)
            enter = state.set_measurement if measurement.latest else state.remember
            enter(node, measurement.value, time, number)
        for number, fact in enumerate(stated, start=1):
            match fact:
                case elements.StatusFact(element, status):
                    state.assert_status(network.find(element), status)
                case elements.RequiredFact(element):
                    state.set_flag("asserted_required", network.find(element), True)
                case elements.SelectedFact(element):
                    state.set_flag("selected", network.find(element), True)
                case elements.ActiveFact(component):
                    state.set_flag("active", network.components[component], True)
                case elements.RequiredActionFact():
                    self._records.begin(fact, -number, now)
        for name in self._records.required:
            state.set_flag("requested", network.actions[name], True)
        state.infer()
        state.before = {}
        self.log.append(Event(1, now, "begin", ()))
        self._revision = 1

    def _follow_model(self, change: elements.Amended | None) -> None:
        """Record a change of the model, unless it is recorded already."""
        if change is None:
            self._catch_up_with_time()
            return
        with self._lock:
            self._complete_event()
            if change is self._followed:
                return
            change.put()  # no fact is recorded meanwhile: each is of one model
            names = [str(getattr(element, "name", element)) for element in change.elements]
            words = f"{', '.join(names)} {change.how} in the model"
            self._record("amend", change.how, change.written, words=words)

    def _renew(self) -> None:
        """Follow the change of the model that is under way; it can be repeated."""
        change = self.model.pending
        if change is not None:
            self._followed = change
            self._state = self._state.moved(Network(self.model), change.elements, self._now)

    # ---------------------------------------------------------------- causes

    def _cause_of_choice(self, chosen: Sequence[Node]) -> int | None:
        """Return the last event that changed these, their owners or alternatives."""
        if not chosen:
            ended = self._records.last_end
            return None if ended is None else ended[1]
        owners = {node.used_by[0] for node in chosen}
        numbers = [
            self._state.changed_by.get(node, 0)
            for owner in owners
            for node in (owner, *owner.requires)
        ]
        return max(numbers) or None

    def _cause_of_request(self) -> int | None:
        """Return the event that just ended another request, else the last about a feasibility."""
        ended = self._records.last_end
        if ended is not None and ended[0] == self._now:
            return ended[1]
        return self._state.feasibility_changed_by

    # ---------------------------------------------------------------- the store

    def _snapshot(self) -> dict[str, Any]:
        """Return all that is known."""
        return {
            "state": self._state.facts(),
            "records": vars(self._records),
            "revision": self._revision,
        }

    def _restore(self, store: Store) -> None:
        """Begin with what a store holds: a snapshot, and the events after it."""
        snapshot, events = store.restored(self._network)
        if snapshot is not None:
            self._state.restore(snapshot["state"])
            vars(self._records).update(snapshot["records"])
            self._revision = snapshot["revision"]
        for event in events:
            self.log.resume(event.number - 1)
            if event.verb == "begin":
                self._begin(self.model.facts, event.time)
                continue
            self._event = event
            self._complete_event()
        self.log.resume(store.saved)
        for number in list(self._records.open_plans):  # an earlier program left them
            self._record("finish_plan", number, "abandoned")
        for attempt in tuple(self._records.attempts.values()):
            if attempt.end is None:
                self._record("finish_attempt", attempt.serial, "abandoned", "its end is not known")
        self.log.time = -inf  # the clock may have started again at 0
        store.left = tuple(self._records.required)

    def _record_store_message(self, words: str) -> None:
        """Record how the store is."""
        with self._lock:
            self._record("store", words)
        self._publish()

    def _plan_of(self, plan: ReconfigurationPlan | int) -> ReconfigurationPlan:
        """Return a plan of this base, given by itself or by its number."""
        plans = self._records.plans
        number = plan.number if isinstance(plan, ReconfigurationPlan) else plan
        own = plans.get(number)
        if own is None or plan not in (own, number):
            raise InvalidValue(
                f"{plan!r} is not a plan of this knowledge base; give one of kb.plans"
            )
        return own

    def _node(self, element: ElementLike, kinds: Iterable[str]) -> Node:
        return resolve(self._state, element, kinds, unique=True)


def _chosen(
    parts: Mapping[str, Node], owners: Mapping[str, Node], choice: Mapping[str, str] | None
) -> list[Node]:
    """Return the nodes of a choice by owner; each has to be a part of its owner."""
    nodes = []
    for owner_name, name in (choice or {}).items():
        node = parts[name]
        owner = owners[owner_name]
        if node not in owner.requires:
            raise InvalidValue(f"{node} is of {node.used_by[0].name!r}, not of {owner.name!r}")
        nodes.append(node)
    return nodes


def _matters(event: Event) -> bool:
    """Return whether a planner may choose otherwise after an event."""
    verb = event.verb
    if verb in ("measure", "stale", "dwell"):
        return bool(event.changes)
    if verb == "select":
        return event.plan is None and bool(event.effects)
    if verb == "finish_plan":
        return bool(event.arguments[1] != "failed")
    return verb not in RECORDS
