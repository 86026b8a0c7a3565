"""The knowledge base: facts come in, statuses follow, actions are requested and configurations selected."""

import logging
import math
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from functools import partial, wraps
from pathlib import Path
from threading import RLock
from typing import Any, Concatenate, Final, ParamSpec, TypeVar
from weakref import finalize

from kb import questions, views
from kb.amendments import amend
from kb.diagnostics import DiagnosticProblem, read_diagnostics
from kb.elements import Parameters, finite_number, flag, status_of, table, text, whole
from kb.elements import parameters as checked_parameters
from kb.events import Event, Log, Publisher
from kb.exceptions import InvalidValue, KnowledgeBaseError, Unselectable
from kb.explanation import why, why_selected
from kb.forecasts import Forecaster, feasible_until
from kb.knowledge import Knowledge
from kb.model import Model
from kb.network import Node
from kb.owl.world import Answer, answers
from kb.questions import ELEMENTS, Meant, meant, outline
from kb.reconfiguration import by_whole, planned, reselect
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
from kb.state import Overlay, State
from kb.status import Status
from kb.store import HELD_OVER_FORKS, KEPT, Store

_log = logging.getLogger(__name__)

_BY_ITSELF: Final = frozenset({"dwell", "lapse", "begin", "store"})
"""The verbs of events that time, the model and the store cause; no caller tells them."""
_TOLD: Final = {"measure": "measure", "amend": "_amend"}
"""The name of the method for each verb that can be told; `_telling` adds the others."""
_OPERATIONS: Final = ("activate", "deactivate", "configure")
_BACK: Final = 1.0
"""How far a clock may go back [s]: threads that read it together tell in any order; clocks are corrected a little."""

P = ParamSpec("P")
T = TypeVar("T")


def _telling(method: Callable[Concatenate["KnowledgeBase", P], T]) -> Callable[Concatenate["KnowledgeBase", P], T]:
    """Make a method hold the base while it tells, after the events that time causes, and then call the subscribers.

    The clock, mappings that are given and subscribers are code of others, which may wait for another thread. So they
    are called without a lock.
    """
    _TOLD[method.__name__.removeprefix("_")] = method.__name__

    @wraps(method)
    def held(self: "KnowledgeBase", *args: P.args, **kwargs: P.kwargs) -> T:
        given = [_own(value) for value in args]
        caused = {name: _own(value) for name, value in kwargs.items()}
        now, log, telling = self._time(), self._knowledge.log, self._knowledge.telling
        with self._lock:
            self._settle(now)
            with telling:
                before = log.last
                result = method(self, *given, **caused)  # type: ignore[arg-type]  # as they were
                told = log.last
        if self._publisher.is_heard:
            self._publisher.deliver(told if told > before else 0)
        return result

    return held  # type: ignore[return-value]  # with self as a name, which is never used


def _own(value: object) -> object:
    return dict(value) if isinstance(value, Mapping) else value


class KnowledgeBase:
    """What is known about a robot now, and what follows from it.

    Args:
        model: what the robot is made of and can do. It may be amended later: the next question sees it.
        clock: gives the time [s]; times of facts, requests and plans are its. By default that is the time of day, in
            seconds since 1970-01-01 UTC.
        store: a file that keeps the log; the base continues from what is in it. See `flush` and `close`.
        keep: how many measurements of each attribute the store keeps; the newest.
        memory: how much of the past is held in memory.

    Time does not go back: while the clock shows less than it did, by up to a second, it stands still, so that facts
    keep the order in which they are told. A clock that goes back further, or gives no time, is refused.

    Facts may be told from any thread; each call holds the base until what follows from it is inferred. Each is in or
    out: whatever interrupts a call, the base answers as if it had been told, or had not.

    Attributes:
        model: as it is now.
        log: the events, in order; the newest, see `Log.begins`.
        history: what is on record and not asked every day.
        store: the file of the log, and what is wrong with it; None without one.
        forecast: looks ahead: `kb.forecast("energy", 30.0)`, see `Forecaster`.
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
            raise InvalidValue(f"the clock is a function that returns the time in seconds, not {clock!r}")
        whole("keep", keep)
        if not isinstance(memory, Memory | None):
            raise InvalidValue(f"how much is held in memory is said by a kb.Memory, not by {memory!r}")
        model.settle()
        self.model = model
        self._time = _Time(clock, model)
        self._lock = RLock()
        self.store = None if store is None else Store(store, model, keep)
        self._knowledge = known = Knowledge(model, self._time, self._lock, memory)
        self._time.known = known
        known.now = now = self._time()
        if self.store is not None and not self.store.is_new:
            self.store.restore(known, now)
            known.log.time = -math.inf  # its clock may have begun anew
        elif model.facts:
            known.begin(model.facts, now)
        self._publisher = Publisher(known.log, self._lock)
        known.heard = self._publisher.deliver
        self._held = _holding(known, self._lock)
        self.forecast = Forecaster(self, known)
        self._keep, self._is_closed = keep, False
        self.log: Log = known.log
        self.log.settle = partial(_settle, model, self._held)
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
            self._catch_up()  # with what time has done meanwhile

    # ---------------------------------------------------------------- asked

    def is_feasible(self, action: str) -> bool:
        """Tell whether an action can be done now: its status is not "unfeasible"."""
        known, network = self._knowledge, self._knowledge.network
        revision, visited, statuses = network.revision, known.state.visited, known.state.status
        if self.model.pending is None and known.pending is None and known.measurements.alarms.next == math.inf:
            node = network.actions.get(action)
            status = statuses[node.index] if node is not None and network.revision == revision else None
            if status is not None and (network.revision, known.state.visited) == (revision, visited):
                return status is not Status.UNFEASIBLE  # one reading needs no lock, unless something is inferred
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
        if due != math.inf and due <= self._time():
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
                    state.value[node.index] if node.kind == "attribute" else state.status[node.index],
                    ", ".join(word for word in ("required", "selected", "active") if getattr(state, word)[node.index]),
                )
                for node in state.network.present()
            ]
            return table(f"{self.model.name}: {outline(state)}", ("kind", "name", "status or value", "and"), rows)

    @property
    def now(self) -> float:
        """The time by the clock [s]."""
        return self._time()

    @property
    def revision(self) -> int:
        """Grows whenever a fact changed that can matter to a planner: a measurement only if a status changed by it."""
        self.reading()  # what time has done by now is in it; one reading needs no lock
        return self._knowledge.revision

    @property
    def required_actions(self) -> tuple[RequiredAction, ...]:
        """The actions that are required now, in the order of their requests."""
        return tuple(self._records().required.values())

    @property
    def plans(self) -> tuple[ReconfigurationPlan, ...]:
        """Every plan, in the order in which they were made."""
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
        """Every process that a component ran as, in the order in which they were started."""
        return tuple(self._records().processes.values())

    def query(self, sparql: str, timeout: float = 10.0) -> list[tuple[Answer, ...]]:
        """Answer a SPARQL query over the model, all that was told, and the statuses that follow from it.

        Args:
            sparql: a SELECT; `:` and `rosa:` stand for the words of ROSA.
            timeout: how long it may take [s].

        Returns:
            One tuple for each answer: numbers, texts, booleans, None; an individual is given as its IRI.

        Raises:
            InvalidValue: it is no query, or would change something.
            KnowledgeBaseError: it was stopped at its time-out.
        """
        if finite_number(timeout) <= 0:
            raise InvalidValue(f"a timeout is a time in seconds above 0, not {timeout!r}")
        return answers(sparql, timeout, self._knowledge, self.store, self._keep, self._held)

    # ---------------------------------------------------------------- told: what is so

    def measure(self, attribute: str, value: float) -> None:
        """Tell that an attribute was measured just now.

        Raises:
            UnknownName: no such attribute.
            InvalidValue: not a finite number, or outside the attribute's range; the facts are as they were.
        """
        node = self._knowledge.network.attributes[attribute]
        of: Any = node.element
        is_plain = type(value) is float and math.isfinite(value) and of.low <= value <= of.high
        number = value if is_plain else questions.number(f"{attribute} cannot be measured as", value, node)
        known, now = self._knowledge, self._time()
        with self._lock:
            self._settle(now)
            with known.telling:
                told = known.measure(node, number, known.now).number
        if self._publisher.is_heard:
            self._publisher.deliver(told)

    @_telling
    def component_failed(self, component: str, reason: str = "") -> None:
        """Tell that a component has failed; the reason, in words, stands in explanations and in the store."""
        text("the reason of a failure", reason)
        node, state = self._component(component), self._knowledge.state
        is_known = state.failed[node.index] and reason in ("", state.reason("failed", node).text)
        if not is_known:
            self._tell("component_failed", node.name, reason)

    @_telling
    def component_recovered(self, component: str) -> None:
        """Tell that a component has not failed, or no longer."""
        node, state = self._component(component), self._knowledge.state
        if state.failed[node.index] or state.asserted[node.index] is Status.FAILURE:
            self._tell("component_recovered", node.name)

    @_telling
    def component_active(self, component: str, active: bool, reason: str = "") -> None:
        """Tell whether a component is running; why it is not, in words, stands in explanations as long as it is not."""
        node = self._component(component)
        text("the reason why a component is not active", reason)
        if self._knowledge.state.active[node.index] != flag("active", active, InvalidValue):
            self._tell("component_active", node.name, active, reason)

    def receive(self, diagnostics: object) -> tuple[DiagnosticProblem, ...]:
        """Take in a DiagnosticArray; see `kb.diagnostics` for the forms in which it may come.

        Returns:
            What could not be used, and why; all the rest has been taken in. These are logged and counted in
            `history.rejected` too.
        """
        problems = []
        for reading in read_diagnostics(diagnostics):
            if isinstance(reading, DiagnosticProblem):
                problems.append(reading)
                continue
            try:
                getattr(self, reading.verb)(*reading.arguments)
            except KnowledgeBaseError as error:
                problems.append(DiagnosticProblem(reading.arguments[0], reading.written, str(error)))
        for problem in problems:
            _log.warning("diagnostics: %s", problem)
        with self._lock:
            self._knowledge.records.rejected += len(problems)
        return tuple(problems)

    @_telling
    def assert_status(self, element: Meant, status: Status | str, reason: str = "", until: float | None = None) -> None:
        """State an element's status outright; it stands in place of the inferred one until it is retracted.

        Args:
            element: a view, an element of the model, or a name that only one element has.
            status: one that an element of this kind can have.
            reason: why, in words; it stands in explanations and in the store.
            until: when it lapses by itself [s, by the clock of this base], after now; None or `math.inf` for never.
        """
        text("the reason of an asserted status", reason)
        end = None if until is None or until == math.inf else finite_number(until)
        node = self._node(element, ELEMENTS)
        wanted = status_of(node.kind, status)
        if end is not None and end <= (now := self._knowledge.now):
            raise InvalidValue(f"a status is asserted until later than now, {now!r} s by the clock; not {until!r}")
        self._tell("assert_status", node.ref, str(wanted), reason, end)

    @_telling
    def retract_status(self, element: Meant) -> None:
        """Take back an asserted status; the inferred one holds again."""
        self._tell("retract_status", self._node(element, ELEMENTS).ref)

    @_telling
    def assert_required(self, element: Meant, required: bool | None) -> None:
        """State that an element is required; False or None takes that back and hides no inferred requirement."""
        node = self._node(element, ("action", "function", "component"))
        if required is not None:
            flag("required", required, InvalidValue)
        self._tell("assert_required", node.ref, required)

    @_telling
    def assert_selected(self, element: Meant, selected: bool | None, reason: str = "") -> None:
        """State that a design or configuration is the selected one, or is not; the reason stands in explanations."""
        text("the reason why something is selected or not", reason)
        node = self._node(element, ("function design", "configuration"))
        if selected is not None:
            flag("selected", selected, InvalidValue)
        self._tell("assert_selected", node.ref, selected, reason)

    # ---------------------------------------------------------------- told: actions and plans

    @_telling
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
        """Say that an action is no longer required, and how it ended; nothing happens if it is not required.

        Args:
            action: its name.
            result: "completed", "failed" or "abandoned".
            reason: why it ended so, in words; for those who listen and for the history.
            cause: number of the event that led to it; without one, that which made the action unfeasible, if it is.
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
        """Select a design for each function and a configuration for each component named; unselect what is obsolete.

        Args:
            designs: name of the design by name of its function.
            configurations: name of the configuration by name of its component.
            reason: why these, in words, if not by priority; it is kept with what is selected and with the plan.
            dry_run: only return the plan; nothing is selected, and nobody hears of it.
            cause: number of the event that made it needed; without one, the latest that changed what is chosen
                for, or among.

        Returns:
            The plan that leads there from the present state; None if there is nothing to do.

        Raises:
            InvalidValue: one of them is unfeasible now; nothing is selected.
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
            layer = Overlay(known.state)
            reasons = why_selected(layer, [*chosen, *given], now, reason, known.records.ended)
            selection = reselect(layer, chosen, given)
            return planned(layer, selection, reasons, now) if selection else None
        cause = known.cause_of_choice([*chosen, *given]) if cause is None else cause
        event = known.apply(now, "select", (by_whole(chosen), by_whole(given), reason), cause)
        return None if event is None else event.plan

    @_telling
    def finish_plan(self, plan: ReconfigurationPlan | int, result: str) -> bool:
        """Close a plan as "completed", "failed" or "abandoned"; returns whether it was open.

        One that completes abandons every other plan that is open.
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
        """Say why nothing can be selected for what is required, in words, for explanations; empty if something can."""
        text("the reason why nothing can be selected", reason)
        self._tell("note_no_choice", reason)

    # ---------------------------------------------------------------- told: records

    @_telling
    def component_configured(self, component: str, parameters: Parameters) -> None:
        """Tell which parameters a component was given; see `parameters_in_force` of its view."""
        name = self._component(component).name
        self._tell("component_configured", name, checked_parameters(name, parameters))

    @_telling
    def component_started(self, component: str, pid: int) -> Process:
        """Tell that a component runs as a process of the operating system, whether it is active already or not."""
        self._tell("component_started", self._component(component).name, whole("a process number", pid, 0))
        return next(reversed(self._knowledge.records.processes.values()))

    @_telling
    def component_ended(self, component: str, pid: int | None = None) -> None:
        """Tell that the process of a component has ended: that of a number, or all of them."""
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
        """Put on record that a command is given now; `finish_attempt` tells what came of it.

        Args:
            plan: what it is part of; one of `plans`, or its number.
            component: name of what is commanded.
            operation: "activate", "deactivate" or "configure".
            configuration: name of what the component is configured with, None for a switch; with its parameters.
            parameters: what is to be set.
            number: 1 for the first time that the plan gives this command.
        """
        if operation not in _OPERATIONS:
            raise InvalidValue(f"{operation!r} is no operation; an operation is one of {', '.join(_OPERATIONS)}")
        known = self._knowledge
        name, of = self._component(component).name, None
        if configuration is not None:
            of = known.network.configurations[configuration].name
        given = checked_parameters(name, parameters or {})
        whole("the number of an attempt", number)
        self._tell("record_attempt", known.records.plan_of(plan).number, name, operation, of, given, number)
        return next(reversed(known.records.attempts.values()))

    @_telling
    def finish_attempt(self, attempt: Attempt | int, result: str, reason: str = "") -> bool:
        """Put on record what came of a command; returns whether that was not known yet.

        The attempt may be given by its serial number; a result is "completed", "failed" or "abandoned". The parameters
        of a command that has configured a component are in force then.
        """
        if result not in RESULTS:
            check_result(result)
        if reason != "":
            text("the reason why an attempt ends", reason)
        serial = attempt.serial if isinstance(attempt, Attempt) else attempt
        if type(serial) is not int:
            raise InvalidValue(f"{attempt!r} is no attempt; give one of kb.history.attempts, or its serial number")
        record = self._knowledge.records.attempts.get(serial)
        if record is None or record.end is not None:
            return False
        self._tell("finish_attempt", serial, result, reason)
        return True

    @_telling
    def record_answer(self, plan: ReconfigurationPlan | int, is_vetoed: bool, reason: str = "") -> VetoAnswer:
        """Put on record what was answered about a plan before it was executed, and why it was forbidden if it was."""
        flag("is_vetoed", is_vetoed, InvalidValue)
        text("the reason of an answer", reason)
        self._tell("record_answer", self._knowledge.records.plan_of(plan).number, is_vetoed, reason)
        return next(reversed(self._knowledge.records.answers.values()))

    # ---------------------------------------------------------------- the log

    def tell(self, event: Event) -> None:
        """Tell an event again; the clock of this base should show its time.

        What time does comes by itself, and so does what the model states and what is said of the store. Only "stale"
        may come before its time: who measured the attribute is gone.

        Raises:
            InvalidValue: it is no event that can be told; nothing has changed.
        """
        verb = event.verb if isinstance(event, Event) else None
        if verb in _BY_ITSELF:
            self._catch_up()
            return
        if verb not in _TOLD:
            known = ", ".join(sorted(_TOLD))
            raise InvalidValue(f"{event!r} cannot be told; an event that can has one of the verbs {known}")
        tell = getattr(self, _TOLD[verb])
        caused = {"cause": event.cause} if verb in ("request_action", "cancel_action", "select") else {}
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
        if self._knowledge.records.progress.get((action, behaviour), "") != text("what is saved", saved):
            self._tell("progress", action, behaviour, saved)

    @_telling
    def _stale(self, name: str) -> None:
        node, state = self._knowledge.network.attributes[name], self._knowledge.state
        if state.value[node.index] is not None and not state.stale[node.index]:
            self._tell("stale", name)

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call a function with every event from now on, in order; returns how to stop that.

        It is called by a thread that told, which holds nothing meanwhile: it may ask and tell. What it raises is
        logged and reaches nobody else.
        """
        stop = self._publisher.subscribe(callback)
        self._knowledge.in_words = True
        return stop

    @property
    def saved(self) -> int:
        """The number of the last event that is on disk; 0 without a store."""
        return self.store.saved if self.store else 0

    def flush(self, timeout: float | None = None) -> bool:
        """Wait, at most for a timeout [s], until all that was told by now is on disk; returns whether it is."""
        return self.store is not None and self.store.flush(timeout)

    def close(self) -> None:
        """Save what is left and give the store back: what memory holds can be asked, nothing more told; see `flush`."""
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

    def _settle(self, now: float) -> None:
        """Make the events that time causes until now, before something is told; mostly there are none."""
        if self.store is not None:
            self._check_open(self.store)
        known = self._knowledge
        if known.telling.locked():
            known.refuse_in_the_midst()
        last = known.log.time
        known.now = now = now if now >= last else last
        if known.pending is not None or now >= known.measurements.alarms.next:
            known.settle(now)

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


class _Time:
    """The time of a base: that by its clock, or that of the last event if that is later [s].

    Attributes:
        clock: as given.
        known: whose time it is.
    """

    known: Knowledge

    def __init__(self, clock: Callable[[], float], model: Model) -> None:
        self.clock, self._model = clock, model

    def __call__(self) -> float:
        if self._model.pending is not None:
            self._model.settle()
        last, now = self.known.log.time, self.clock()  # in this order, as another thread may tell something meanwhile
        if type(now) is float and last <= now < math.inf:
            return now
        try:
            shown = finite_number(now)
        except InvalidValue as error:
            raise InvalidValue(f"the clock gives {now!r} for the time in seconds: {error}; nothing was told") from None
        if shown < last - _BACK:
            raise InvalidValue(
                f"the clock went back, from {last!r} s to {shown!r} s, and facts keep their order: give the knowledge "
                "base a clock that is not set back, e.g. time.monotonic; nothing was told"
            )
        return max(shown, last)


def _settle(model: Model, held: AbstractContextManager[State]) -> None:
    """Complete or undo an interrupted change of the model or event."""
    if model.pending is not None:
        model.settle()
    with held:
        pass


def _holding(known: Knowledge, lock: Any) -> AbstractContextManager[State]:  # noqa: ANN401  # an RLock has no type
    """Return a context manager that holds a base while it is read, after an interrupted event is completed or undone.

    A signal is handled between two instructions of Python, never within a C function. So one C call takes the lock and
    notes it, and the lock's own method releases it: no interrupt can leave the lock taken.
    """
    once = (True,)

    def enter(_: object) -> State:
        taken: list[bool] = []
        try:
            taken.extend(map(lock.acquire, once))
            return known.state if known.pending is None else known.settled()
        except BaseException:
            if taken:
                lock.release()
            raise

    held: AbstractContextManager[State] = type("Reading", (), {"__enter__": enter, "__exit__": lock.__exit__})()
    return held


def _chosen(parts: Mapping[str, Node], wholes: Mapping[str, Node], given: Mapping[str, str] | None) -> list[Node]:
    """Return the nodes chosen, given by the names of their owners; each must be a part of its owner."""
    if given is not None and not isinstance(given, Mapping):
        raise InvalidValue(f"what is selected is given as choice by name of what it is for, not as {given!r}")
    chosen = [(parts[name], wholes[whole]) for whole, name in (given or {}).items()]
    for node, owner in chosen:
        if node.wholes[0] is not owner:
            raise InvalidValue(f"{node.kind} {node.name!r} is of {node.wholes[0].name!r}, not of {owner.name!r}")
    return [node for node, _ in chosen]
