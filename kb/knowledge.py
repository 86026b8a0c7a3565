"""What is known: the result of applying all events of a log in order, each as a whole or not at all.

While an event changes facts and statuses, the old values are kept; if it is interrupted, the next caller restores them.
Once these changes are complete, the event is in: then records, histories and alarms are updated, and if that is
interrupted, the next caller does it again. Both steps can be repeated any number of times with the same result.
"""

import math
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import starmap
from operator import attrgetter
from threading import Lock
from types import MappingProxyType
from typing import Any, Final, Literal

from kb import facts
from kb.elements import (
    Action,
    Attribute,
    Constraint,
    Element,
    Estimation,
    Parameters,
    finite_number,
)
from kb.events import RECORDS, Event, Log, StatusChange
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.explanation import note_nothing, reading, staleness, why_selected
from kb.measurements import Judged, Measurements
from kb.model import Model, amendment
from kb.network import Network, Node, Ref
from kb.owl import Serials
from kb.planning import apply_selection, decide
from kb.records import (
    Attempt,
    Memory,
    Process,
    ReconfigurationPlan,
    Records,
    RequiredAction,
    VetoAnswer,
    finish,
)
from kb.state import FACTS, UNSET, History, Reason, State, infer_anew, propagate
from kb.status import UNFEASIBLE, Status

Put = Sequence[Any]
"""A function that updates records, histories or alarms and can be called again, and its arguments."""

_NEW: Final = tuple.__new__  # quicker than the constructor of an event
_ENDED: Final = 4
"""How many ended requests the reason of a plan names at most."""

_BACK: Final = 1.0
"""How far a clock may go back [s]: clocks are corrected, and threads may tell in another order than they read it."""

_STATUSES: Final = ("asserted", "verdict")
_IN_THE_MIDST: Final = (
    "a signal handler or finalizer can ask and tell nothing in the midst of an event; do that later"
)

_Pending = tuple[Event, Sequence[Put], bool] | Literal["open"]
"""An event that is in, the updates that must still be made, and whether it matters to a planner; or "open" for an event
that is not in yet."""


class Reading:
    """A context manager that gives a state while it holds a lock, or another one of these.

    Python handles a signal between two instructions, never within a C function. So one C call takes what is held and
    notes that, and another one gives it back: no interrupt can leave the lock taken.
    """

    def __init__(self, held: Any, give: Callable[[Any], State]) -> None:  # noqa: ANN401  # an RLock has no type
        self._held, self._give = held, give

    def __enter__(self) -> State:
        taken: list[Any] = []
        try:
            taken.extend(starmap(self._held.__enter__, ((),)))
            return self._give(taken[0])
        except BaseException:
            if taken:
                self._held.__exit__(None, None, None)
            raise

    __exit__ = property(attrgetter("_held.__exit__"))


class Knowledge:
    """Facts, the statuses that follow from them, and the records.

    Args:
        model: the model that the facts are about; this object observes its changes, see `Observer`.
        clock: the function that gives the time [s]; see `time`.
        lock: every caller holds it; a change of the model takes it itself.
        memory: how much of the past is held in memory.
    """

    def __init__(
        self,
        model: Model,
        clock: Callable[[], float],
        lock: AbstractContextManager[object],
        memory: Memory | None = None,
    ) -> None:
        self._memory = memory = memory or Memory()
        self.model, self.clock, self._lock = model, clock, lock
        self.network = network = Network(model)
        self.serials = Serials.of(model)
        self.log = Log(memory, lock, self.complete)
        self.state = State(network)
        propagate(
            self.state, [node for node in network.functions.values() if not node.parts]
        )  # all else is feasible
        self.measurements = Measurements(self.state, memory)
        self.records = Records(memory)
        self.now = -math.inf  # all events that time causes are made until here [s]
        self.revision = 0  # number of the last event that can matter to a planner
        self.changed_by: dict[
            int, int
        ] = {}  # by node: the last event that changed its status, plans aside
        self.feasibility: int | None = (
            None  # number of the event that last made an action feasible or unfeasible
        )
        self.in_words = False  # whether events of measurements have a text too
        self.heard: Callable[[], None] = lambda: (
            None
        )  # called after a change of the model, without the lock
        self.pending: _Pending | None = None  # an event that was interrupted; see `finish`
        self.telling = (
            Lock()
        )  # held, with the other lock, from the checks of a fact until its event is in
        self._amended: facts.Amended | None = None
        self._before: Mapping[Node, Status] = {}

    # ---------------------------------------------------------------- putting in place

    def apply(
        self, time: float, verb: str, arguments: tuple[Any, ...], cause: int | None = None
    ) -> Event | None:
        """Make an event from a verb and its arguments and apply it; None if it would change nothing."""
        if self.pending is not None:
            self.finish()
        if verb not in RECORDS:
            self._open()
        event = _NEW(Event, (self.log.last + 1, time, verb, arguments, (), cause, (), None, ""))
        made: Event | None = getattr(self, f"_{verb}")(event, *arguments)
        if made is None:
            self.finish()
        return made

    def measure(self, node: Node, value: float, time: float) -> Event:
        """Make the event of a measurement and apply it; written for speed, as it is the most frequent event."""
        if self.pending is not None:
            self.finish()
        index, state, log, measurements = node.index, self.state, self.log, self.measurements
        before, thresholds = state.value[index], self.network.thresholds(node)
        recent = () if node.element.agreement == (1, 1) else measurements.with_latest(node, value)
        history = state.histories.get(index)
        if history is None:
            history = measurements.history(node)
        count = len(history.pairs)
        if count >= history.many:
            history.forget()
            count = len(history.pairs)
        touched: Sequence[Node] = ()
        if before is None or state.stale[index]:
            touched = node.constraints
        elif value != before:
            touched = thresholds.crossed(before, value)
        words = ""
        if self.in_words or log.witnesses:
            words = f"{node.name} is {reading(value, thresholds.around(value), node)}"
        puts: list[Put] = [(measurements.put, node, value, time, history, count, recent)]
        changes: Sequence[StatusChange] = ()
        if touched or thresholds.steady:
            self._open()
            state.put(state.value, index, value)
            state.put(state.stale, index, False)
            if thresholds.steady:
                judged, turned = self._judge(thresholds.steady, value, recent, time)
                touched = [*turned, *touched]
                puts.append((measurements.put_judged, judged, time))
            changes = propagate(state, touched)
        arguments = (node.name, value)
        event = _NEW(
            Event, (log.last + 1, time, "measure", arguments, tuple(changes), None, (), None, words)
        )
        self.pending = event, puts, bool(changes)
        if touched or thresholds.steady or log.witnesses:
            self.finish()
        else:  # as `finish` does, in fewer steps
            measurements.put(node, value, time, history, count, recent)
            log.append(event)
            self.pending = None
        return event

    def settle(self, now: float) -> None:
        """Complete or undo an interrupted event, then make the events that time causes until now [s]."""
        if self.telling.locked():
            self.refuse_in_the_midst()
        last = self.log.time
        self.now = now = now if now >= last else last
        if self.pending is not None or now >= self.measurements.alarms.next:
            with self.telling:
                self.finish()
                self.now = max(now, self.log.time)
                self.advance(self.now)

    def advance(self, now: float) -> None:
        """Make the events that time causes until now, each with the time at which it was due."""
        while (due := self.measurements.alarms.due(now)) is not None:
            time, key = (
                max(due[0], self.log.time),
                due[1],
            )  # a changed model may make it due in the past
            node = self.network.nodes[key if key >= 0 else ~key]
            if key < 0:
                until = self.state.reason("asserted", node).until
                if until is not None and until <= time:
                    self.apply(time, "lapse", (node.ref, str(self.state.asserted[node.index])))
                self.measurements.alarms.clear(key)
            elif node.kind == "attribute":
                self.apply(time, "stale", (node.name,))
            else:
                self.apply(time, "dwell", (node.ref,))

    def finish(self) -> None:
        """Undo the pending event if it is not in; complete it if it is in."""
        pending, state = self.pending, self.state
        if pending is None:
            return
        if pending == "open":
            state.undo()
            self.pending = None
            return
        event, puts, matters = pending
        number, verb, changes = event.number, event.verb, event.changes
        if state.kept is not None:
            state.version = number
        for put, *given in puts:
            put(*given)
        if verb == "amend":
            changes = self._changes()
            event = Event(*event[:4], changes, *event[5:])
        if changes:
            # not a switch by a plan; when a component stops by itself, a reason is given
            if verb != "component_active" or event.arguments[2] or not self.records.open_plans:
                status, changed_by = state.status, self.changed_by
                for array, index, _ in state.kept or ():
                    if array is status:
                        changed_by[index] = number
            for one in changes:
                if one.kind == "action" and UNFEASIBLE in (one.old, one.new):
                    self.feasibility = number
        if matters:
            self.revision = number
        is_new = self.log.last < number
        self.log.append(event)
        state.kept = self.pending = None
        for witness in self.log.witnesses if is_new else ():
            witness(event)

    def time(self) -> float:
        """Return the time by the clock, or that of the last event if it is later [s].

        The clock is foreign code, which may wait for another thread, so it is read without the lock.
        """
        if self.model.pending is not None:
            self.model.settle()
        last, now = self.log.time, self.clock()  # in this order: another thread may tell meanwhile
        if type(now) is float and last <= now < math.inf:
            return now
        try:
            shown = finite_number(now)
        except InvalidValue as error:
            raise InvalidValue(
                f"the clock gives {now!r} for the time in seconds: {error}; nothing was told"
            ) from None
        if shown < last - _BACK:
            raise InvalidValue(
                f"the clock went back, from {last!r} s to {shown!r} s, and facts keep their order: give the knowledge "
                "base a clock that is not set back, e.g. time.monotonic; nothing was told"
            )
        return max(shown, last)

    def complete(self) -> None:
        """Complete or undo a change of the model, or an event, that was interrupted."""
        if self.model.pending is not None:
            self.model.settle()
        with self._lock:
            self.settled()

    def settled(self, _: object = None) -> State:
        """Return the state, after an interrupted event is completed or undone."""
        if self.pending is not None:
            self.refuse_in_the_midst()
            with self.telling:
                self.finish()
        return self.state

    def refuse_in_the_midst(self) -> None:
        """Raise KnowledgeBaseError if this thread, which holds the lock, is already applying an event."""
        if self.telling.locked():
            raise KnowledgeBaseError(_IN_THE_MIDST)

    def _put(
        self,
        event: Event,
        touched: Sequence[Node] = (),
        *puts: Put,
        changes: Sequence[StatusChange] = (),
        effects: tuple[tuple[str, str, bool], ...] = (),
        plan: ReconfigurationPlan | None = None,
        words: str = "",
        matters: bool | None = True,
    ) -> Event:
        """Infer what follows from the touched nodes, then complete the event.

        `changes` are those made already; it and the arguments after it are as in `Event`. `matters` is whether planners
        need it; None: if a status changed.
        """
        if touched:
            changes = [*changes, *propagate(self.state, touched)]
        if changes or effects or plan is not None or words:
            event = _NEW(Event, (*event[:4], tuple(changes), event.cause, effects, plan, words))
        self.pending = event, puts, bool(changes) if matters is None else matters
        self.finish()
        return event

    def _open(self) -> None:
        """Begin to change the state: the old values are kept until the event is in."""
        self.state.kept = []
        self.pending = "open"

    def _judge(
        self,
        constraints: Iterable[Node],
        value: float | None,
        recent: tuple[float, ...],
        now: float,
    ) -> tuple[list[Judged], list[Node]]:
        """Judge debounced constraints by the latest measurements; returns that, and those whose verdict changed."""
        verdict = self.state.verdict
        judged = [
            self.measurements.judge(one, value, recent, verdict[one.index], now)
            for one in constraints
        ]
        changed = [(node, after) for node, after, _ in judged if after is not None]
        for node, after in changed:
            self.state.put(verdict, node.index, after)
        return judged, [node for node, _ in changed]

    # ---------------------------------------------------------------- what time does

    def _stale(self, event: Event, name: str) -> Event:
        node = self.network.attributes[name]
        self.state.put(self.state.stale, node.index, True)
        words = f"{name} {staleness(self.state.time[node.index], node, event.time)}"
        put = self.measurements.put_stale, node
        return self._put(event, node.constraints, put, words=words, matters=None)

    def _dwell(self, event: Event, ref: Ref) -> Event | None:
        node = self.network.referred(ref)
        attribute = node.parts[0].index
        value, recent = self.state.value[attribute], self.measurements.recent.get(attribute, ())
        judged, touched = self._judge([node], value, recent, event.time)
        if not touched:
            self.measurements.put_judged(judged, event.time)
            return None
        words = f"{node.name} is {judged[0].verdict}, after its dwell"
        return self._put(
            event,
            touched,
            (self.measurements.put_judged, judged, event.time),
            words=words,
            matters=None,
        )

    def _lapse(self, event: Event, ref: Ref, status: str) -> Event:
        return self._asserted(
            event, ref, None, words=f"no longer asserted {status}: its time is over"
        )

    # ---------------------------------------------------------------- what is so

    def _component_failed(self, event: Event, name: str, reason: str) -> Event:
        return self._stated(event, self.network.components[name], "failed", True, reason)

    def _component_recovered(self, event: Event, name: str) -> Event:
        node, state = self.network.components[name], self.state
        if state.asserted[node.index] is Status.FAILURE:
            state.put(state.asserted, node.index, None)
            state.give_reason("asserted", node)
        return self._stated(event, node, "failed", False)

    def _component_active(self, event: Event, name: str, active: bool, reason: str) -> Event:
        return self._stated(
            event, self.network.components[name], "active", active, "" if active else reason
        )

    def _stated(
        self, event: Event, node: Node, column: str, is_so: bool, reason: str = ""
    ) -> Event:
        self.state.put(self.state.columns[column], node.index, is_so)
        self.state.give_reason(column, node, reason)
        return self._put(event, [node])

    def _assert_status(
        self, event: Event, ref: Ref, status: str, reason: str, until: float | None
    ) -> Event:
        words = f"asserted {status}{Reason(reason, until)}"
        return self._asserted(event, ref, Status(status), reason, until, words=words)

    def _retract_status(self, event: Event, ref: Ref) -> Event:
        return self._asserted(event, ref, None, words="no longer asserted")

    def _asserted(
        self,
        event: Event,
        ref: Ref,
        status: Status | None,
        reason: str = "",
        until: float | None = None,
        *,
        words: str,
    ) -> Event:
        node, alarms = self.network.referred(ref), self.measurements.alarms
        self.state.put(self.state.asserted, node.index, status)
        self.state.give_reason("asserted", node, reason, until)
        put = (alarms.clear, ~node.index) if until is None else (alarms.set, ~node.index, until)
        return self._put(event, [node], put, words=f"{node.name} is {words}")

    def _assert_required(self, event: Event, ref: Ref, required: bool | None) -> Event:
        return self._stated(event, self.network.referred(ref), "asserted_required", bool(required))

    def _assert_selected(self, event: Event, ref: Ref, selected: bool | None, reason: str) -> Event:
        node, state = self.network.referred(ref), self.state
        state.put(state.selected, node.index, bool(selected))
        whole = node.wholes[0]
        is_without = reason and not any(state.selected[part.index] for part in whole.parts)
        state.give_reason("unselected", whole, reason if is_without else "")
        return self._stated(event, node, "selected", bool(selected), reason if selected else "")

    def _note_no_choice(self, event: Event, reason: str) -> Event:
        note_nothing(self.state, reason)
        return self._put(event, matters=False)

    # ---------------------------------------------------------------- requests and plans

    def _request_action(
        self, event: Event, name: str, preference: str | Mapping[str, float] | None
    ) -> Event:
        node = self.network.actions[name]
        self.state.put(self.state.requested, node.index, True)
        if preference is not None and not isinstance(preference, str):
            preference = MappingProxyType(dict(preference))
        record = RequiredAction(
            name, preference, event.time, cause=event.cause, number=event.number
        )
        return self._put(event, [node], (self.records.put, "requests", event.number, record))

    def _cancel_action(self, event: Event, name: str, result: str, reason: str) -> Event:
        node, record = self.network.actions[name], self.records.required[name]
        self.state.put(self.state.requested, node.index, False)
        words = f"{name} is {result}: {reason}" if reason else f"{name} is {result}"
        ended = (*self.records.ended, words)[-_ENDED:] if reason else self.records.ended
        end = {"result": result, "end": event.time, "reason": reason}
        return self._put(
            event, [node], (self.records.end_request, record, ended, event.number, end)
        )

    def _select(
        self,
        event: Event,
        designs: Mapping[str, str],
        configurations: Mapping[str, str],
        reason: str,
    ) -> Event | None:
        state, network = self.state, self.network
        chosen = [network.designs[name] for name in designs.values()]
        given = [network.configurations[name] for name in configurations.values()]
        why = why_selected(state, [*chosen, *given], event.time, reason, self.records.ended)
        selection = decide(state, [*chosen, *given])
        changes = apply_selection(state, selection)
        flips = selection.flips
        effects = tuple((node.kind, node.name, state.selected[node.index]) for node in flips)
        before = len(state.kept or ())
        for node in dict.fromkeys([*flips, *chosen, *given]):
            state.give_reason("selected", node, reason if state.selected[node.index] else "")
            state.give_reason("unselected", node.wholes[0])
        if selection:
            number = next(reversed(self.records.plans), 0) + 1
            plan = selection.plan(state, why, event.time, event.cause, number)
            put = self.records.put, "plans", number, plan
            return self._put(
                event, (), put, changes=changes, effects=effects, plan=plan, matters=False
            )
        if not effects and len(state.kept or ()) == before:
            return None
        return self._put(event, changes=changes, effects=effects, matters=bool(effects))

    def _finish_plan(self, event: Event, number: int, result: str) -> Event:
        put = self.records.end_plan, self.records.plans[number], result, event.time
        return self._put(event, (), put, matters=result != "failed")

    # ---------------------------------------------------------------- records

    def _component_configured(
        self, event: Event, name: str, parameters: Mapping[str, Any]
    ) -> Event:
        return self._recorded(event, self._configure(name, MappingProxyType(dict(parameters))))

    def _component_started(self, event: Event, name: str, pid: int) -> Event:
        process = Process(name, pid, event.time, number=event.number)
        return self._recorded(event, (self.records.put, "processes", event.number, process))

    def _component_ended(self, event: Event, name: str, pid: int | None) -> Event | None:
        running = [
            one
            for one in self.records.processes.values()
            if one.component == name and one.end is None
        ]
        ended = [(finish, one, {"end": event.time}) for one in running if pid in (None, one.pid)]
        return self._recorded(event, *ended) if ended else None

    def _record_attempt(self, event: Event, plan: int, *command: Any) -> Event:  # noqa: ANN401  # see `Attempt`
        component, operation, configuration, parameters, number = command
        serial, made = next(reversed(self.records.attempts), 0) + 1, self.records.plans[plan]
        given = MappingProxyType(dict(parameters))
        attempt = Attempt(
            made, component, operation, configuration, given, number, event.time, serial=serial
        )
        return self._recorded(event, (self.records.put, "attempts", serial, attempt))

    def _finish_attempt(self, event: Event, serial: int, result: str, reason: str) -> Event:
        attempt = self.records.attempts[serial]
        puts: list[Put] = [
            (finish, attempt, {"result": result, "reason": reason, "end": event.time})
        ]
        if attempt.operation == "configure" and result == "completed":
            puts.append(self._configure(attempt.component, attempt.parameters))
        return self._recorded(event, *puts)

    def _record_answer(self, event: Event, plan: int, is_vetoed: bool, reason: str) -> Event:
        answer = VetoAnswer(self.records.plans[plan], event.time, is_vetoed, reason)
        return self._recorded(event, (self.records.put, "answers", event.number, answer))

    def _progress(self, event: Event, action: str, behaviour: str, saved: str) -> Event:
        return self._recorded(
            event, (self.records.progress.__setitem__, (action, behaviour), saved)
        )

    def _store(self, event: Event, _: str) -> Event:
        return self._recorded(event)

    def _configure(self, component: str, parameters: Parameters) -> Put:
        return self.state.parameters.__setitem__, component, parameters

    def _recorded(self, event: Event, *puts: Put) -> Event:
        return self._put(event, (), *puts, matters=False)

    # ---------------------------------------------------------------- the model

    def begin(self, facts: Sequence[facts.Fact], now: float) -> None:
        for position, fact in enumerate(facts):
            self._begin_with(fact, -position - 1, now)
        self.log = Log(self._memory, self._lock, self.complete)
        self.log.append(Event(1, now, "begin", ()))
        self.changed_by.clear()
        self.feasibility, self.revision, self.state.version = None, 1, 1

    def _begin_with(self, fact: facts.Fact, number: int, now: float) -> None:
        if isinstance(fact, facts.MeasurementFact):
            node, time = (
                self.network.attributes[fact.attribute],
                now if fact.time is None else fact.time,
            )
            if fact.latest:
                self.measure(node, fact.value, time)
            else:
                history = self.measurements.history(node)
                history.add(time, fact.value, len(history.pairs))
        elif isinstance(fact, facts.StatusFact):
            self.apply(
                now,
                "assert_status",
                (self.network.find(fact.element).ref, str(fact.status), "", None),
            )
        elif isinstance(fact, facts.RequiredFact):
            self.apply(now, "assert_required", (self.network.find(fact.element).ref, True))
        elif isinstance(fact, facts.SelectedFact):
            self.apply(now, "assert_selected", (self.network.find(fact.element).ref, True, ""))
        elif isinstance(fact, facts.ActiveFact):
            self.apply(now, "component_active", (fact.component, True, ""))
        else:
            self.records.begin(fact, number, now)
            if isinstance(fact, facts.RequiredActionFact) and fact.action in self.records.required:
                node = self.network.actions[fact.action]
                self.state.requested[node.index] = True
                propagate(self.state, [node])

    def prepare(self) -> None:
        """Make the events that time causes until now, before the model changes; an error of the clock prevents that."""
        now = self.time()
        with self._lock:
            self.settle(now)

    def catch_up(self) -> None:
        """Make the events that time causes until now, unless this thread is just telling a fact."""
        now = self.time()
        with self._lock:
            if self.pending is not None or not self.telling.locked():
                self.settle(now)

    def amended(self, change: facts.Amended) -> None:
        """Make the event of a change of the model, unless it is made already."""
        with self._lock:
            self.refuse_in_the_midst()
            with self.telling:
                self.finish()
                if change is not self._amended:
                    change.put()  # no fact is told meanwhile: each is told of the model before or after
                    self._follow(change)

    def _follow(self, change: facts.Amended) -> None:
        for element in change.elements if change.how == "removed" else ():
            if isinstance(element, Action) and element.name in self.records.required:
                self.apply(
                    self.now,
                    "cancel_action",
                    (element.name, "abandoned", "it is no longer in the model"),
                )
        self.state.kept = None
        self._before = {node: self.state.status[node.index] for node in self.network.present()}
        gone = [
            node
            for node in self._before
            if change.how == "removed" and node.element in change.elements
        ]
        named = [
            one for one in change.elements if not isinstance(one, Estimation)
        ] or change.elements
        names = ", ".join(one.name if isinstance(one, Element) else str(one) for one in named)
        written = tuple(amendment(change.how, change.elements, self.serials))
        event = Event(
            self.log.last + 1,
            self.now,
            "amend",
            written,
            words=f"{names} {change.how} in the model",
        )
        self.pending = event, ((self._renew, change, gone),), True
        self.finish()

    def _renew(self, change: facts.Amended, gone: Sequence[Node]) -> None:
        """Update the network to the model as it is now and infer all statuses anew; it can be called again."""
        self.network.renew()
        for node in gone:
            self.state.forget(node)
            self.state.parameters.pop(node.name if node.kind == "component" else "", None)
            for key in (node.index, ~node.index):
                self.measurements.alarms.clear(key)
        self.state.grow()
        for element in change.elements if change.how != "removed" else ():
            if isinstance(element, Attribute | Constraint):
                self.measurements.renew(self.network.find(element), self.now)
        infer_anew(self.state)
        self._amended = change

    def _changes(self) -> tuple[StatusChange, ...]:
        """Return the changes of status since before the model changed."""
        now = [
            (node, self._before.get(node, UNSET[node.kind]), self.state.status[node.index])
            for node in self.network.present()
        ]
        return tuple(
            StatusChange(node.kind, node.name, old, new) for node, old, new in now if old is not new
        )

    # ---------------------------------------------------------------- the fold, and what it is at one moment

    def repeat(self, event: Event) -> None:
        """Apply an event of a log again, with the number it had, to the model as it is now."""
        self.log.resume(event.number - 1)
        if event.verb == "measure":
            name, value = event.arguments
            self.measure(self.network.attributes[name], value, event.time)
        elif event.verb == "begin":
            self.begin(self.model.facts, event.time)
        else:
            self.apply(event.time, event.verb, event.arguments, event.cause)
        self.log.last = event.number

    def to_json(self, keep: int) -> dict[str, Any]:
        """Return all that is known as values that JSON can hold."""
        here = {node.index: node.ref for node in self.network.present()}

        def by_ref(values: Iterable[tuple[int, Any]]) -> list[tuple[Ref, Any]]:
            return [(here[index], value) for index, value in values if index in here]

        columns, remembered = self.state.columns, self.measurements
        reasons = [(key, one) for key, one in self.state.reasons.items() if one != Reason()]
        return {
            "facts": {
                name: by_ref(
                    (index, value) for index, value in enumerate(columns[name]) if value != unset
                )
                for name, unset in FACTS.items()
            },
            "reasons": [
                (name, here[index], *one) for (name, index), one in reasons if index in here
            ],
            "parameters": {name: dict(given) for name, given in self.state.parameters.items()},
            "histories": [
                (node.name, b64encode(history.packed(keep)).decode(), history.begins_within(keep))
                for node in self.network.attributes.values()
                for history in (remembered.history(node),)
            ],
            "recent": by_ref(remembered.recent.items()),
            "since": by_ref(remembered.since.items()),
            "records": self.records.to_json(),
            "changed_by": by_ref(self.changed_by.items()),
            "feasibility": self.feasibility,
        }

    def from_json(self, written: Mapping[str, Any], number: int, time: float) -> None:
        """Restore what `to_json` returned: the state after the event of this number, at its time [s]."""
        network, state, remembered = self.network, self.state, self.measurements
        touched: dict[Node, None] = {}
        for name, values in written["facts"].items():
            for ref, value in values:
                node = network.referred(ref)
                touched[node] = None
                state.columns[name][node.index] = Status(value) if name in _STATUSES else value
        for name, ref, text, until in written["reasons"]:
            node = network.referred(ref)
            state.give_reason(name, node, text, until)
            if until is not None:
                remembered.alarms.set(~node.index, until)
        state.parameters.update(
            {name: MappingProxyType(given) for name, given in written["parameters"].items()}
        )
        for name, packed, begins in written["histories"]:
            state.histories[network.attributes[name].index] = History(
                self._memory, b64decode(packed), begins
            )
        remembered.recent.update(
            {network.referred(ref).index: tuple(values) for ref, values in written["recent"]}
        )
        remembered.since.update(
            {network.referred(ref).index: since for ref, since in written["since"]}
        )
        self.records.from_json(written["records"])
        self.changed_by.update(
            {network.referred(ref).index: number for ref, number in written["changed_by"]}
        )
        self.feasibility = written["feasibility"]
        for node in network.attributes.values():
            remembered.resume(node, time)
        propagate(state, touched)
        self.revision = state.version = number
        self.log.resume(number)

    # ---------------------------------------------------------------- what led to what

    def cause_of_choice(self, chosen: Sequence[Node]) -> int | None:
        """Return the last event that changed these choices, their owners or alternatives, or else ended a request."""
        about = [
            one.index for node in chosen for whole in node.wholes for one in (whole, *whole.parts)
        ]
        known = [self.changed_by[index] for index in about if index in self.changed_by]
        if not chosen and self.records.last_end is not None:
            known = [self.records.last_end[1]]
        return max(known, default=None)

    def cause_of_request(self, now: float) -> int | None:
        """Return the event that ended another request at this instant, else the last that changed a feasibility."""
        ended = self.records.last_end
        return ended[1] if ended is not None and ended[0] == now else self.feasibility

    def cause_of_end(self, action: Node, result: str) -> int | None:
        is_in_vain = result != "completed" and self.state.status[action.index] is Status.UNFEASIBLE
        return self.changed_by.get(action.index) if is_in_vain else None
