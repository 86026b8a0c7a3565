"""The knowledge base: it takes in facts, infers statuses, and keeps the required actions and what is selected."""

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from functools import wraps
from math import inf, isfinite
from pathlib import Path
from threading import RLock
from typing import Any, Concatenate, Final, ParamSpec, TypeVar
from weakref import finalize

from kb import questions, views
from kb.diagnostics import DiagnosticProblem, DiagnosticRules, record_diagnostics
from kb.elements import Parameters, finite_number, flag, status_of, table, text, whole
from kb.elements import parameters as checked_parameters
from kb.events import Event, Log, Publisher
from kb.exceptions import InvalidValue, KnowledgeBaseError, Unselectable
from kb.explanation import why, why_selected
from kb.forecast import Forecaster, feasible_until
from kb.knowledge import Knowledge, Reading
from kb.model import Model, amend
from kb.network import Node
from kb.ontology import Answer, Ontology
from kb.planning import by_owner, decide
from kb.questions import ELEMENTS, Meant, meant, outline
from kb.records import (
    RESULTS,
    Attempt,
    HistoryView,
    Memory,
    Process,
    ReconfigurationPlan,
    Records,
    Reply,
    RequiredAction,
    VetoAnswer,
    check_result,
)
from kb.state import State
from kb.status import Status
from kb.store import HELD_OVER_FORKS, KEPT, Store

_BY_ITSELF: Final = frozenset({"dwell", "lapse", "begin", "store"})
"""The verbs of events that are caused by time, by the model or by the store, and never told by a caller."""
_TOLD: Final = {"measure": "measure", "amend": "_amend"}
"""The name of the method for each verb that can be told; `_telling` adds the others."""
_PLAIN: Final = (str, int, views.ElementView)
"""Most arguments are of these classes, and to ask whether something is a mapping takes long."""
_OPERATIONS: Final = ("activate", "deactivate", "configure")

P = ParamSpec("P")
T = TypeVar("T")


def _telling(
    method: Callable[Concatenate["KnowledgeBase", P], T],
) -> Callable[Concatenate["KnowledgeBase", P], T]:
    """Make a method tell facts: hold the lock, make the events that are due, run it, then call the subscribers.

    The clock, the mappings among the arguments and the subscribers are foreign code, which may wait for another
    thread. So they are called without the lock.
    """
    _TOLD[method.__name__.removeprefix("_")] = method.__name__

    @wraps(method)
    def held(self: "KnowledgeBase", *args: P.args, **kwargs: P.kwargs) -> T:
        given = [_own(value) for value in args]
        caused = {name: _own(value) for name, value in kwargs.items()} if kwargs else kwargs
        known = self._knowledge
        now = known.time()
        with self._lock:
            if self.store is not None:
                self._check_open(self.store)
            known.settle(now)
            with known.telling:
                before = known.log.last
                result = method(self, *given, **caused)  # type: ignore[arg-type]  # the same arguments
                told = known.log.last
        if self._publisher.is_heard:
            self._publisher.deliver(told if told > before else 0)
        return result

    return held  # type: ignore[return-value]  # nobody passes self by name


def _own(value: object) -> object:
    return value if isinstance(value, _PLAIN) or not isinstance(value, Mapping) else dict(value)


class KnowledgeBase:
    """What is known about a robot now, and what follows from it.

    Args:
        model: what the robot is made of and can do. It may be amended later; the next question sees the change.
        clock: returns the time [s]; facts, requests and plans get their times from it. By default it is the time of
            day, in seconds since 1970-01-01 UTC.
        store: the file that keeps the log; the base continues from what is in it. See `flush` and `close`.
        keep: how many measurements of each attribute the store keeps; it keeps the newest.
        memory: how much of the past is held in memory.

    Time does not go back, so that facts keep the order in which they are told: if the clock goes back up to a second,
    time stands still until the clock has caught up. A clock that goes back further, or returns no time, is refused.

    Facts may be told from any thread; each call holds the lock until all that follows from the fact is inferred. Each
    fact is in or out: if a call is interrupted, the base answers as if the fact was told, or as if it was not.

    Attributes:
        model: the model as it is now.
        log: the events, in order; it holds the newest ones, see `Log.begins`.
        history: records that are needed less often.
        store: the file of the log, and its error if it has one; None without a store.
        forecast: predicts attributes, as in `kb.forecast("energy", 30.0)`; see `Forecaster`.
        actions, functions, components, designs, configurations, attributes: read-only views by name.
    """

    def __init__(
        self,
        model: Model,
        *,
        clock: Callable[[], float] = time.time,
        store: str | Path | None = None,
        keep: int = KEPT,
        memory: Memory | None = None,
    ) -> None:
        if not isinstance(model, Model):
            raise InvalidValue(f"a knowledge base is made of a kb.Model, not of {model!r}")
        if not callable(clock):
            raise InvalidValue(
                f"the clock is a function that returns the time in seconds, not {clock!r}"
            )
        whole("keep", keep)
        if not isinstance(memory, Memory | None):
            raise InvalidValue(
                f"how much is held in memory is said by a kb.Memory, not by {memory!r}"
            )
        model.settle()
        self.model = model
        self._lock = RLock()
        self.store = None if store is None else Store(store, model, keep)
        self._knowledge = known = Knowledge(model, clock, self._lock, memory)
        known.now = now = known.time()
        if self.store is not None and not self.store.is_new:
            self.store.restore(known, now)
            known.log.time = -inf  # the clock may have started again at 0
        elif model.facts:
            known.begin(model.facts, now)
        self._publisher = Publisher(known.log, self._lock)
        known.heard = self._publisher.deliver
        self._held = Reading(self._lock, known.settled)
        self.forecast = Forecaster(self)
        self._ontology, self._is_closed = Ontology(self), False
        self.log: Log = known.log
        self.history = HistoryView(known.records, self.reading)
        network = known.network
        self.actions = views.Views(self, network.actions, views.ActionView)
        self.functions = views.Views(self, network.functions, views.FunctionView)
        self.components = views.Views(self, network.components, views.ComponentView)
        self.designs = views.Views(self, network.designs, views.DesignView)
        self.configurations = views.Views(self, network.configurations, views.ConfigurationView)
        self.attributes = views.Views(self, network.attributes, views.AttributeView)
        model.watch(known)
        HELD_OVER_FORKS[self._lock] = -1.0
        if self.store is not None:
            self.store.start(known, self._lock)
            finalize(self, self.store.close)
            self._catch_up()  # with the events that came due meanwhile

    # ---------------------------------------------------------------- asked

    def is_feasible(self, action: str) -> bool:
        """Tell whether an action can be done now: its status is not "unfeasible"."""
        known, network = self._knowledge, self._knowledge.network
        revision, visited, statuses = network.revision, known.state.visited, known.state.status
        if (
            self.model.pending is None
            and known.pending is None
            and known.measurements.alarms.next == inf
        ):
            node = network.actions.get(action)
            status = (
                statuses[node.index] if node is not None and network.revision == revision else None
            )
            if status is not None and (network.revision, known.state.visited) == (
                revision,
                visited,
            ):
                return (
                    status is not Status.UNFEASIBLE
                )  # a single read needs no lock unless inference runs
        return questions.is_feasible(self, action)

    selectable_actions = questions.selectable_actions
    selectable_designs = questions.selectable_designs
    selectable_configurations = questions.selectable_configurations
    best_configuration = questions.best_configuration
    adaptable_functions = questions.adaptable_functions
    adaptable_components = questions.adaptable_components
    obsolete = questions.obsolete
    explain = questions.explain
    why = questions.why
    explain_choice = questions.explain_choice
    situation = questions.suppose
    feasible_until = feasible_until

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with` statement."""
        if self.model.pending is not None:
            self.model.settle()
        due = self._knowledge.measurements.alarms.next
        if due != inf and due <= self._knowledge.time():
            self._catch_up()
        return self._held

    def __repr__(self) -> str:
        with self.reading() as state:
            return f"<KnowledgeBase {self.model.name!r}: {outline(state)}>"

    def _repr_html_(self) -> str:
        with self.reading() as state:
            rows = [
                (
                    node.kind,
                    node.name,
                    state.value[node.index]
                    if node.kind == "attribute"
                    else state.status[node.index],
                    ", ".join(
                        word
                        for word in ("required", "selected", "active")
                        if getattr(state, word)[node.index]
                    ),
                )
                for node in state.network.present()
            ]
            return table(
                f"{self.model.name}: {outline(state)}",
                ("kind", "name", "status or value", "and"),
                rows,
            )

    @property
    def now(self) -> float:
        """The time by the clock [s]."""
        return self._knowledge.time()

    @property
    def revision(self) -> int:
        """Grows whenever a fact changes that can matter to a planner; a measurement counts only if a status changes."""
        self.reading()  # makes the events that are due; a single read needs no lock
        return self._knowledge.revision

    @property
    def required_actions(self) -> tuple[RequiredAction, ...]:
        """The actions that are required now, in the order of their requests."""
        return tuple(self._records().required.values())

    @property
    def plans(self) -> tuple[ReconfigurationPlan, ...]:
        """All plans, in the order in which they were made."""
        return tuple(self._records().plans.values())

    @property
    def latest_plan(self) -> ReconfigurationPlan | None:
        """The plan that was made last."""
        return next(reversed(self._records().plans.values()), None)

    @property
    def pending_plan(self) -> ReconfigurationPlan | None:
        """The latest plan that has not ended."""
        return next(reversed(self._records().open_plans.values()), None)

    @property
    def processes(self) -> tuple[Process, ...]:
        """All processes in which components ran or run, in the order in which they were started."""
        return tuple(self._records().processes.values())

    def query(self, sparql: str, timeout: float = 10.0) -> list[tuple[Answer, ...]]:
        """Answer a SPARQL query over the model, all facts that were told, and the statuses that follow from them.

        Args:
            sparql: a SELECT query; the prefixes `:` and `rosa:` stand for the vocabulary of ROSA.
            timeout: how long the query may take [s].

        Returns:
            One tuple for each answer, of numbers, texts, booleans or None; an individual is given by its IRI.

        Raises:
            InvalidValue: the text is no query, or the query would change something.
            KnowledgeBaseError: the query did not end within the timeout.
        """
        if finite_number(timeout) <= 0:
            raise InvalidValue(f"a timeout is a time in seconds above 0, not {timeout!r}")
        return self._ontology.query(sparql, timeout)

    @property
    def ontology(self) -> Any:  # noqa: ANN401  # of owlready2, which has no types
        """The model and what is known now as a `World` of owlready2, up to date; to be read only."""
        return self._ontology.world

    # ---------------------------------------------------------------- told: what is so

    def measure(self, attribute: str, value: float) -> None:
        """Tell that an attribute was measured just now.

        Raises:
            UnknownName: the model has no such attribute.
            InvalidValue: the value is not a finite number or is outside the attribute's range; nothing is told.
        """
        known = self._knowledge
        node = known.network.attributes[attribute]
        of: Any = node.element
        is_plain = type(value) is float and isfinite(value) and of.low <= value <= of.high
        number = (
            value
            if is_plain
            else questions.number(f"{attribute} cannot be measured as", value, node)
        )
        now = known.time()
        with self._lock:
            if self.store is not None:
                self._check_open(self.store)
            known.settle(now)
            with known.telling:
                told = known.measure(
                    known.network.attributes[attribute], number, known.now
                ).number  # if still there
        if self._publisher.is_heard:
            self._publisher.deliver(told)

    @_telling
    def component_failed(self, component: str, reason: str = "") -> None:
        """Tell that a component has failed; explanations and the store give the reason, in words."""
        text("the reason of a failure", reason)
        node, state = self._component(component), self._knowledge.state
        is_known = state.failed[node.index] and reason in ("", state.reason("failed", node).text)
        if not is_known:
            self._tell("component_failed", node.name, reason)

    @_telling
    def component_recovered(self, component: str) -> None:
        """Tell that a component works again after a failure."""
        node, state = self._component(component), self._knowledge.state
        if state.failed[node.index] or state.asserted[node.index] is Status.FAILURE:
            self._tell("component_recovered", node.name)

    @_telling
    def component_active(self, component: str, active: bool, reason: str = "") -> None:
        """Tell whether a component is running; if it is not, explanations give the reason, in words."""
        node = self._component(component)
        text("the reason why a component is not active", reason)
        if self._knowledge.state.active[node.index] != flag("active", active, InvalidValue):
            self._tell("component_active", node.name, active, reason)

    def receive(
        self, diagnostics: object, *, rules: DiagnosticRules | None = None
    ) -> tuple[DiagnosticProblem, ...]:
        """Record the facts in a DiagnosticArray of ROS; see `kb.diagnostics` for the forms that are accepted.

        Args:
            diagnostics: the array.
            rules: the meaning of statuses that are not ROSA's own.

        Returns:
            The parts that could not be used, and why; all other parts are recorded. These problems are also logged,
            and counted in `history.rejected`.
        """
        problems = record_diagnostics(self, diagnostics, rules)
        with self._lock:
            self._knowledge.records.rejected += len(problems)
        return problems

    @_telling
    def assert_status(
        self, element: Meant, status: Status | str, reason: str = "", until: float | None = None
    ) -> None:
        """Set an element's status; it replaces the inferred status until it is retracted or lapses.

        Args:
            element: a view, an element of the model, or a name that only one element has.
            status: one that an element of this kind can have.
            reason: why, in words; explanations and the store give it.
            until: when it lapses by itself [s, by the clock of this base], later than now; None or `math.inf`: never.
        """
        text("the reason of an asserted status", reason)
        end = None if until is None or until == inf else finite_number(until)
        node = self._node(element, ELEMENTS)
        wanted = status_of(node.kind, status)
        if end is not None and end <= (now := self._knowledge.now):
            raise InvalidValue(
                f"a status is asserted until later than now, {now!r} s by the clock; not {until!r}"
            )
        self._tell("assert_status", node.ref, str(wanted), reason, end)

    @_telling
    def retract_status(self, element: Meant) -> None:
        """Take back an asserted status; the inferred status holds again."""
        self._tell("retract_status", self._node(element, ELEMENTS).ref)

    @_telling
    def assert_required(self, element: Meant, required: bool | None) -> None:
        """State that an element is required; False or None takes that back, but not an inferred requirement."""
        node = self._node(element, ("action", "function", "component"))
        if required is not None:
            flag("required", required, InvalidValue)
        self._tell("assert_required", node.ref, required)

    @_telling
    def assert_selected(self, element: Meant, selected: bool | None, reason: str = "") -> None:
        """State whether a design or configuration is selected; explanations give the reason."""
        text("the reason why something is selected or not", reason)
        node = self._node(element, ("function design", "configuration"))
        if selected is not None:
            flag("selected", selected, InvalidValue)
        self._tell("assert_selected", node.ref, selected, reason)

    # ---------------------------------------------------------------- told: actions and plans

    @_telling
    def request_action(
        self,
        action: str,
        preference: str | Mapping[str, float] | None = None,
        *,
        cause: int | None = None,
    ) -> Reply:
        """Request that the robot is configured for an action; an unfeasible action is refused, with the reason.

        Args:
            action: name of the action.
            preference: name of the attribute to favour when a configuration is chosen for the action, or a mapping
                from names of attributes to weights.
            cause: number of the event that led to the request; by default the event that ended another action at this
                instant, else the latest event that made an action feasible or unfeasible.
        """
        known = self._knowledge
        node = known.network.actions[action]
        wanted, now = questions.preferred(known.network, preference), known.now
        if node.name in known.records.required:
            return Reply(True, f"{node.name} is required already")
        if known.state.status[node.index] is Status.UNFEASIBLE:
            return Reply(False, why(known.state, node, now))
        cause = known.cause_of_request(now) if cause is None else cause
        known.apply(now, "request_action", (node.name, wanted), cause)
        return Reply(True, f"{node.name} is required")

    @_telling
    def cancel_action(
        self, action: str, result: str = "abandoned", reason: str = "", *, cause: int | None = None
    ) -> None:
        """Tell that an action is no longer required, and how it ended; nothing happens if it is not required.

        Args:
            action: name of the action.
            result: "completed", "failed" or "abandoned".
            reason: why the action ended in this way, in words; subscribers and the history get it.
            cause: number of the event that led to the end; by default the one that made the action unfeasible, if any.
        """
        known = self._knowledge
        node = known.network.actions[action]
        check_result(result)
        text("the reason why an action ends", reason)
        now = known.now
        if node.name in known.records.required:
            cause = known.cause_of_end(node, result) if cause is None else cause
            known.apply(now, "cancel_action", (node.name, result, reason), cause)

    @_telling
    def select(
        self,
        designs: Mapping[str, str] | None = None,
        configurations: Mapping[str, str] | None = None,
        reason: str = "",
        *,
        dry_run: bool = False,
        cause: int | None = None,
    ) -> ReconfigurationPlan | None:
        """Select a design for each given function, a configuration for each given component; unselect what is obsolete.

        Args:
            designs: maps the name of a function to the name of its design.
            configurations: maps the name of a component to the name of its configuration.
            reason: why these are chosen, in words, if not by priority; it is kept with the selection and with the plan.
            dry_run: only return the plan; nothing is selected, and no event is made.
            cause: number of the event that led to the selection; by default the latest event that changed one of the
                functions, components or alternatives.

        Returns:
            The plan that leads from the present state to the selection; None if there is nothing to do.

        Raises:
            InvalidValue: a design or configuration is unfeasible now; nothing is selected.
        """
        if reason != "":
            text("the reason of a choice", reason)
        known = self._knowledge
        network = known.network
        chosen = _chosen(network.designs, network.functions, designs)
        given = _chosen(network.configurations, network.components, configurations)
        now = known.now
        for node in (*chosen, *given):
            if known.state.status[node.index] is Status.UNFEASIBLE:
                raise Unselectable(f"{node} cannot be selected: {why(known.state, node, now)}")
        if dry_run:
            state = known.state
            reasons = why_selected(state, [*chosen, *given], now, reason, known.records.ended)
            selection = decide(state, [*chosen, *given])
            return selection.plan(state, reasons, now) if selection else None
        cause = known.cause_of_choice([*chosen, *given]) if cause is None else cause
        event = known.apply(now, "select", (by_owner(chosen), by_owner(given), reason), cause)
        return None if event is None else event.plan

    @_telling
    def finish_plan(self, plan: ReconfigurationPlan | int, result: str) -> bool:
        """End a plan as "completed", "failed" or "abandoned"; returns whether it was open.

        When a plan completes, all other open plans are abandoned.
        """
        if result not in RESULTS:
            check_result(result)
        made = self._knowledge.records.plan_of(plan)
        if made.end is not None:
            return False
        self._knowledge.apply(self._knowledge.now, "finish_plan", (made.number, result), made.cause)
        return True

    @_telling
    def note_no_choice(self, reason: str) -> None:
        """Give explanations the reason why nothing can be selected for what is required; empty if something can."""
        text("the reason why nothing can be selected", reason)
        self._tell("note_no_choice", reason)

    # ---------------------------------------------------------------- told: records

    @_telling
    def component_configured(self, component: str, parameters: Parameters) -> None:
        """Tell which parameters were set on a component; see `parameters_in_force` of its view."""
        name = self._component(component).name
        self._tell("component_configured", name, checked_parameters(name, parameters))

    @_telling
    def component_started(self, component: str, pid: int) -> Process:
        """Tell that a process of the operating system was started for a component; it need not be active yet."""
        self._tell(
            "component_started", self._component(component).name, whole("a process number", pid, 0)
        )
        return next(reversed(self._knowledge.records.processes.values()))

    @_telling
    def component_ended(self, component: str, pid: int | None = None) -> None:
        """Tell that a process of a component has ended: the one with this number, or all of them without one."""
        number = None if pid is None else whole("a process number", pid, 0)
        self._tell("component_ended", self._component(component).name, number)

    @_telling
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
        if operation not in _OPERATIONS:
            raise InvalidValue(
                f"{operation!r} is no operation; an operation is one of {', '.join(_OPERATIONS)}"
            )
        known = self._knowledge
        name, of = self._component(component).name, None
        if configuration is not None:
            of = known.network.configurations[configuration].name
        given = checked_parameters(name, parameters or {})
        whole("the number of an attempt", number)
        self._tell(
            "record_attempt", known.records.plan_of(plan).number, name, operation, of, given, number
        )
        return next(reversed(known.records.attempts.values()))

    @_telling
    def finish_attempt(self, attempt: Attempt | int, result: str, reason: str = "") -> bool:
        """Record the result of a command; returns False if the attempt has ended already or is unknown.

        The attempt may be given by its serial number; the result is "completed", "failed" or "abandoned". When a
        "configure" command completes, its parameters are in force.
        """
        if result not in RESULTS:
            check_result(result)
        if reason != "":
            text("the reason why an attempt ends", reason)
        serial = attempt.serial if isinstance(attempt, Attempt) else attempt
        if type(serial) is not int:
            raise InvalidValue(
                f"{attempt!r} is no attempt; give one of kb.history.attempts, or its serial number"
            )
        record = self._knowledge.records.attempts.get(serial)
        if record is None or record.end is not None:
            return False
        self._tell("finish_attempt", serial, result, reason)
        return True

    @_telling
    def record_answer(
        self, plan: ReconfigurationPlan | int, is_vetoed: bool, reason: str = ""
    ) -> VetoAnswer:
        """Record whether a plan was vetoed before its execution, and why."""
        flag("is_vetoed", is_vetoed, InvalidValue)
        text("the reason of an answer", reason)
        self._tell("record_answer", self._knowledge.records.plan_of(plan).number, is_vetoed, reason)
        return next(reversed(self._knowledge.records.answers.values()))

    # ---------------------------------------------------------------- the log

    def tell(self, event: Event) -> None:
        """Repeat an event, e.g. of another base; the clock of this base should show the time of the event.

        Events that time, the model or the store cause are made by this base itself, not repeated. Of these,
        only "stale" is repeated: an attribute may be stale before its time because its source is gone.

        Raises:
            InvalidValue: the event cannot be told; nothing has changed.
        """
        verb = event.verb if isinstance(event, Event) else None
        if verb in _BY_ITSELF:
            self._catch_up()
            return
        if verb not in _TOLD:
            known = ", ".join(sorted(_TOLD))
            raise InvalidValue(
                f"{event!r} cannot be told; an event that can has one of the verbs {known}"
            )
        tell = getattr(self, _TOLD[verb])
        caused = (
            {"cause": event.cause} if verb in ("request_action", "cancel_action", "select") else {}
        )
        try:
            tell(*event.arguments, **caused)
        except (AttributeError, LookupError, TypeError) as error:
            if isinstance(error, KnowledgeBaseError):
                raise
            raise InvalidValue(f"{verb} cannot be told with {event.arguments!r}: {error}") from None

    def _amend(self, how: str, written: Any) -> None:  # noqa: ANN401  # what JSON holds
        amend(self.model, self._knowledge.serials, how, written)

    @_telling
    def _progress(self, action: str, behaviour: str, saved: str) -> None:
        if self._knowledge.records.progress.get((action, behaviour), "") != text(
            "what is saved", saved
        ):
            self._tell("progress", action, behaviour, saved)

    @_telling
    def _stale(self, name: str) -> None:
        node, state = self._knowledge.network.attributes[name], self._knowledge.state
        if state.value[node.index] is not None and not state.stale[node.index]:
            self._tell("stale", name)

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call a function with every event from now on, in order; returns a function that ends the subscription.

        The callback runs on a thread that tells facts, without the lock, so it may ask and tell. An exception in it
        is logged and goes no further.
        """
        stop = self._publisher.subscribe(callback)
        self._knowledge.in_words = True
        return stop

    @property
    def saved(self) -> int:
        """The number of the last event that is on disk; 0 without a store."""
        return self.store.saved if self.store else 0

    def flush(self, timeout: float | None = None) -> bool:
        """Wait, at most for a timeout [s], until all events so far are on disk; returns whether they are."""
        return self.store is not None and self.store.flush(timeout)

    def close(self) -> None:
        """Save all events and close the store; you can still ask what is held in memory, but tell nothing more."""
        with self._lock:
            self._is_closed = self.store is not None
        if self.store is not None:
            self.store.close()

    # ---------------------------------------------------------------- helpers

    def _records(self) -> Records:
        with self.reading():
            return self._knowledge.records

    def _tell(self, verb: str, *arguments: Any) -> None:  # noqa: ANN401  # of the verb
        self._knowledge.apply(self._knowledge.now, verb, arguments)

    def _catch_up(self) -> None:
        self._knowledge.catch_up()
        if self._publisher.is_heard:
            self._publisher.deliver()

    def _check_open(self, store: Store) -> None:
        store.check_owner()
        if self._is_closed:
            raise KnowledgeBaseError(
                "this knowledge base is closed: its store is given back, so nothing more can be told. Tell before you "
                "close it, or make a new one of the same model and store"
            )

    def _component(self, name: str) -> Node:
        return self._knowledge.network.components[name]

    def _node(self, element: Meant, kinds: Iterable[str]) -> Node:
        return meant(self, self._knowledge.state, element, kinds, unique=True)


def _chosen(
    parts: Mapping[str, Node], wholes: Mapping[str, Node], given: Mapping[str, str] | None
) -> list[Node]:
    """Return the chosen nodes from a mapping of owner to choice, by name; each choice must be a part of its owner."""
    if given is not None and not isinstance(given, Mapping):
        raise InvalidValue(
            f"what is selected is given as choice by name of what it is for, not as {given!r}"
        )
    chosen = [(parts[name], wholes[whole]) for whole, name in (given or {}).items()]
    for node, owner in chosen:
        if node.wholes[0] is not owner:
            raise InvalidValue(
                f"{node.kind} {node.name!r} is of {node.wholes[0].name!r}, not of {owner.name!r}"
            )
    return [node for node, _ in chosen]
