"""Facts in: what monitors and others tell, and what follows from it, told to those who listen."""

import logging
import math
from collections.abc import Callable, Collection
from typing import Any

from kb.declarations import text as checked_text
from kb.diagnostics import DiagnosticProblem, Measurement, read_diagnostics
from kb.elements import Constraint, Element, finite_number
from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.explanation.choice import note_nothing
from kb.explanation.reasons import shortest
from kb.history import History
from kb.inference.alarms import Alarms
from kb.inference.measuring import Measurements
from kb.inference.network import Network, Node, Ref
from kb.inference.settling import settle
from kb.inference.state import Reason, State
from kb.questions import ELEMENTS
from kb.recording import Recording
from kb.status import STATUSES, Status
from kb.views import ElementView

__all__ = ["Telling"]

_log = logging.getLogger(__name__)


class Telling(Recording):
    """Everything that can be told of the robot, from any thread.

    Args:
        network: what depends on what.
        clock: gives the time [s].
    """

    def __init__(self, network: Network, clock: Callable[[], float]) -> None:
        super().__init__(network, clock)
        self._measurements = Measurements(self._known)
        self._lapses = Alarms()
        self._rejected = 0
        self._revision = 0

    @property
    def _state(self) -> State:
        """The facts, of which none is older than it may be."""
        self._look_at_the_clock()
        return self._known

    def measure(self, attribute: str, value: float) -> None:
        """Tell that an attribute was measured just now.

        Raises:
            UnknownName: no such attribute.
            InvalidValue: not a finite number; the facts are as they were.
        """
        node = self.attributes.node(attribute)
        number = value if type(value) is float and math.isfinite(value) else _measured(attribute, value)
        with self._lock:
            self._check_open()
            now = self._clock()
            if now >= self._measurements.next_change or now >= self._lapses.next:
                self._look_at_the_clock()
            touched = self._measurements.take(node, number, now)
            if self._journal.keeps_measurements:
                self._journal.measured(node.name, number, now)
            told = (node.name, number)
            self._tell(now, "measure", told, node, lambda: self._said_of(node, number), touched, plain=True)

    def component_failed(self, component: str, reason: str = "") -> None:
        """Tell that a component has failed.

        Args:
            component: its name.
            reason: why, in words; it stands in explanations and in the store.
        """
        self._report(component, failed=True, reason=checked_text("the reason of a failure", reason))

    def component_recovered(self, component: str) -> None:
        """Tell that a component has not failed, or no longer."""
        self._report(component, failed=False)

    def component_active(self, component: str, active: bool, reason: str = "") -> None:
        """Tell whether a component is running.

        Args:
            component: its name.
            active: whether it is.
            reason: why it is not any more, in words; it stands in explanations as long as it is not.
        """
        node = self.components.node(component)
        running = _yes("active", active)
        checked_text("the reason why a component is not active", reason)
        with self._lock:
            self._check_open()
            if self._known.active[node.index] == running:
                return
            now = self._clock()
            self._known.active[node.index] = running
            self._known.give_reason("active", node, "" if running else reason)
            words = "active" if running else f"inactive{self._known.reason('active', node)}"
            self._tell(now, "component_active", (node.name, running, reason), node, lambda: f"{node.name} is {words}")

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

    def assert_status(
        self,
        element: ElementView | Element | Constraint | Ref | str,
        status: Status | str,
        reason: str = "",
        until: float | None = None,
    ) -> None:
        """State an element's status outright; it stands in place of the inferred one until it is retracted.

        Args:
            element: a view, an element of the model, or a name that only one element has.
            status: one that an element of this kind can have.
            reason: why, in words; it stands in explanations and in the store.
            until: when it lapses by itself [s, by the clock of this base], after now; None or `math.inf` for never.
        """
        try:
            wanted = Status(status)
        except ValueError:
            known = ", ".join(repr(str(one)) for one in Status)
            raise InvalidValue(f"{status!r} is no status; a status is one of {known}") from None
        checked_text("the reason of an asserted status", reason)
        end = None if until is None or until == math.inf else finite_number(until)
        self._assert_status(element, wanted, reason, end)

    def retract_status(self, element: ElementView | Element | Constraint | Ref | str) -> None:
        """Take back an asserted status; the inferred one holds again."""
        self._assert_status(element, None)

    def assert_required(self, element: ElementView | Element | Constraint | Ref | str, required: bool | None) -> None:
        """State that an element is required; False or None takes that back and hides no inferred requirement."""
        with self._lock:
            self._check_open()
            node = self._node(element, ("action", "function", "component"), unique=True)
            now = self._clock()
            self._known.asserted_required[node.index] = required is not None and _yes("required", required)
            words = "asserted required" if required else "no longer asserted required"
            self._tell(now, "assert_required", (node.ref, required), node, lambda: f"{node.name} is {words}")

    def assert_selected(
        self, element: ElementView | Element | Constraint | Ref | str, selected: bool | None, reason: str = ""
    ) -> None:
        """State that a design or configuration is the selected one, or is not.

        Args:
            element: a view, an element of the model, or a name that only one element has.
            selected: whether it is.
            reason: why, in words; where none is selected by that, explanations say it of what is left without one.
        """
        checked_text("the reason why something is selected or not", reason)
        with self._lock:
            self._check_open()
            node = self._node(element, ("function design", "configuration"), unique=True)
            now, whole, state = self._clock(), node.wholes[0], self._known
            state.selected[node.index] = is_selected = selected is not None and _yes("selected", selected)
            state.give_reason("selected", node, reason if is_selected else "")
            is_without = not any(state.selected[part.index] for part in whole.parts)
            state.give_reason("unselected", whole, reason if is_without else "")
            words = f"{'' if is_selected else 'not '}selected{Reason(reason)}"
            told = (node.ref, selected, reason)
            self._tell(now, "assert_selected", told, node, lambda: f"{node.name} is {words}")

    @property
    def rejected(self) -> int:
        """How many parts of diagnostics could not be used so far."""
        return self._rejected

    @property
    def revision(self) -> int:
        """Grows whenever a fact changed that can matter to a planner: a measurement only if a status changed by it."""
        self._look_at_the_clock()
        return self._revision

    def note_no_choice(self, reason: str) -> None:
        """Say why nothing can be selected for what is required, in words, for explanations; empty if something can."""
        checked_text("the reason why nothing can be selected", reason)
        with self._lock:
            self._check_open()
            note_nothing(self._known, reason)
            words = f"nothing can be selected because {reason}" if reason else "something can be selected again"
            self._happened(self._clock(), "note_no_choice", (reason,), lambda: words)

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Have a function called with every event, in order; returns how to stop that.

        It is called by the thread that told, which holds the base meanwhile: it may ask and tell, but must not wait
        for another thread that does. What it raises is logged and reaches nobody else.
        """
        return self._publisher.subscribe(callback)

    def _check_may_wait(self) -> None:
        if self._publisher.is_telling_here:
            raise KnowledgeBaseError(
                "a subscriber cannot wait until what it hears is on disk, for that is written after it has returned; "
                "flush, close or query after the call that told"
            )

    def _history_of(self, attribute: Node) -> History:
        return self._measurements.history_of(attribute)

    def _look_at_the_clock(self) -> None:
        """Take note of what has become so with time since somebody last looked."""
        next_change, lapse = self._measurements.next_change, self._lapses.next
        if lapse < next_change:
            next_change = lapse
        if next_change == math.inf or self._clock() < next_change:
            return
        with self._lock:
            now = self._clock()
            for node, text, touched in self._measurements.due(now):
                verb = "dwell" if node.kind == "constraint" else "stale"
                told = (node.ref if node.kind == "constraint" else node.name,)
                self._tell(now, verb, told, node, lambda said=text: said, touched, plain=True)  # type: ignore[misc]  # a default binds it now

            for index in self._lapses.due(now):
                self._lapse(self._known.network.nodes[index], now)

    def _lapse(self, node: Node, now: float) -> None:
        """Take back an asserted status, if it is one whose time has come."""
        until = self._known.reason("asserted", node).until
        if until is None or until > now:
            return
        status, self._known.asserted[node.index] = self._known.asserted[node.index], None
        self._known.give_reason("asserted", node)
        self._journal.enter(until, self._known, [node])
        words = f"{node.name} is no longer asserted {status}: its time is over"
        self._tell(until, "lapse", (node.ref, status), node, lambda: words)

    def _report(self, component: str, failed: bool, reason: str = "") -> None:
        node = self.components.node(component)
        with self._lock:
            self._check_open()
            now, state = self._clock(), self._known
            retracts = not failed and state.asserted[node.index] is Status.FAILURE
            is_known = state.failed[node.index] == failed and reason in ("", state.reason("failed", node).text)
            if retracts:
                state.asserted[node.index] = None
                state.give_reason("asserted", node)
            elif is_known:
                return
            state.failed[node.index] = failed
            state.give_reason("failed", node, reason)
            words = f"has failed{Reason(reason)}" if failed else "is recovered"
            verb, told = ("component_failed", (node.name, reason)) if failed else ("component_recovered", (node.name,))
            self._tell(now, verb, told, node, lambda: f"{node.name} {words}")

    def _assert_status(
        self,
        element: ElementView | Element | Constraint | Ref | str,
        status: Status | None,
        reason: str = "",
        until: float | None = None,
    ) -> None:
        with self._lock:
            self._check_open()
            node = self._node(element, ELEMENTS, unique=True)
            if status is not None and status not in STATUSES[node.kind]:
                known = ", ".join(STATUSES[node.kind])
                raise InvalidValue(f"a {node.kind} is never {status!s}; it can be {known}")
            now = self._clock()
            if until is not None and until <= now:
                raise InvalidValue(f"a status is asserted until later than now, {now!r} s by the clock; not {until!r}")
            self._known.asserted[node.index] = status
            self._known.give_reason("asserted", node, reason, until)
            if until is not None:
                self._lapses.set(node.index, until)
            words, verb, told = "no longer asserted", "retract_status", (node.ref,)
            if status is not None:
                words = f"asserted {status}{Reason(reason, until)}"
                verb, told = "assert_status", (node.ref, status, reason, until)  # type: ignore[assignment]  # as the verb has them
            self._tell(now, verb, told, node, lambda: f"{node.name} is {words}")

    def _tell(
        self,
        now: float,
        verb: str,
        arguments: tuple[Any, ...],
        node: Node,
        words: Callable[[], str],
        touched: Collection[Node] | None = None,
        plain: bool = False,
        cause: int | None = None,
    ) -> int:
        """Infer what follows from changed facts, enter the event and publish it; returns its number.

        Args:
            now: the time [s].
            verb: of the event.
            arguments: of the event.
            node: what the event is about.
            words: gives the event in words; asked only if somebody listens.
            touched: the nodes whose facts changed, if not the one that the event is about.
            plain: it matters only if a status changed by it.
            cause: number of the event that caused it.
        """
        nodes = [node] if touched is None else touched
        changes = settle(self._known, nodes)
        self._journal.enter(now, self._known, nodes)
        if changes or not plain:
            self._revision += 1
        return self._happened(now, verb, arguments, words, changes, cause=cause)

    def _said_of(self, attribute: Node, value: float) -> str:
        reading = shortest(value, self._network.thresholds(attribute).around(value))
        return f"{attribute.name} is {reading}"


def _yes(what: str, value: object) -> bool:
    if isinstance(value, bool):
        return value
    raise InvalidValue(f"{what} is True or False, not {value!r}")


def _measured(attribute: str, value: object) -> float:
    try:
        return finite_number(value)
    except InvalidValue as error:
        raise InvalidValue(f"{attribute} cannot be measured as {value!r}: {error}") from None
