"""Facts in: what monitors and others tell, and what follows from it, told to those who listen."""

import logging
import math
from collections.abc import Callable, Collection, Iterable

from kb.declarations import parameters as checked_parameters
from kb.declarations import pid as checked_pid
from kb.diagnostics import DiagnosticProblem, Measurement, read_diagnostics
from kb.elements import Constraint, Element, Parameters, finite_number
from kb.events import Event, EventKind, Publisher, StatusChange
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.explanation import shortest
from kb.history import History, Process
from kb.inference import Change, initial_state, settle
from kb.journal import Journal
from kb.measuring import Measurements
from kb.network import Network, Node
from kb.questions import ELEMENTS, Questions
from kb.state import State
from kb.status import STATUSES, Status
from kb.views import ElementView

__all__ = ["Telling"]

_log = logging.getLogger(__name__)


class Telling(Questions):
    """Everything that can be told of the robot, from any thread.

    Args:
        network: what depends on what.
        clock: gives the time [s].
    """

    def __init__(self, network: Network, clock: Callable[[], float]) -> None:
        super().__init__(network, clock)
        self._known = initial_state(network)
        self._publisher = Publisher()
        self._measurements = Measurements(self._known)
        self._processes: list[Process] = []
        self._journal = Journal(network.model)
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
            now = self._clock()
            if now >= self._measurements.next_change:
                self._look_at_the_clock()
            touched = self._measurements.take(node, number, now)
            if self._journal.keeps_measurements:
                self._journal.measured(node.name, number, now)
            self._tell(EventKind.MONITORING_DATA, now, node, lambda: self._reading(node, number), touched, plain=True)

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
            if self._known.active[node.index] == running:
                return
            now = self._clock()
            self._known.active[node.index] = running
            words = "active" if running else "inactive"
            self._tell(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    def component_configured(self, component: str, parameters: Parameters) -> None:
        """Tell which parameters a component was given; see `parameters_in_force` of its view."""
        node = self.components.node(component)
        with self._lock:
            self._in_force[node.name] = dict(checked_parameters(node.name, parameters))
            self._journal.configured(self._clock(), node, self._in_force[node.name])

    def component_started(self, component: str, pid: int) -> Process:
        """Tell that a component runs as a process of the operating system, whether it is active already or not."""
        node = self.components.node(component)
        checked_pid(pid)
        with self._lock:
            process = Process(node.name, pid, self._clock())
            self._processes.append(process)
            self._journal.enter(process.start, self._known, (), [process])
            return process

    def component_ended(self, component: str, pid: int | None = None) -> None:
        """Tell that the process of a component has ended: that of a number, or all of them."""
        node = self.components.node(component)
        if pid is not None:
            checked_pid(pid)
        with self._lock:
            now = self._clock()
            for process in self._processes:
                if process.component == node.name and process.end is None and pid in (None, process.pid):
                    process._finish(now)
                    self._journal.enter(now, self._known, (), [process])

    @property
    def processes(self) -> tuple[Process, ...]:
        """Every process that a component ran as, in the order in which they were started."""
        with self._lock:
            return tuple(self._processes)

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

    def assert_status(self, element: ElementView | Element | Constraint | str, status: Status | str) -> None:
        """State an element's status outright; it stands in place of the inferred one until it is retracted."""
        try:
            wanted = Status(status)
        except ValueError:
            known = ", ".join(repr(str(one)) for one in Status)
            raise InvalidValue(f"{status!r} is no status; a status is one of {known}") from None
        self._assert_status(element, wanted)

    def retract_status(self, element: ElementView | Element | Constraint | str) -> None:
        """Take back an asserted status; the inferred one holds again."""
        self._assert_status(element, None)

    def assert_required(self, element: ElementView | Element | Constraint | str, required: bool | None) -> None:
        """State that an element is required; False or None takes that back and hides no inferred requirement."""
        with self._lock:
            node = self._node(element, ("action", "function", "component"), unique=True)
            now = self._clock()
            self._known.asserted_required[node.index] = required is not None and _yes("required", required)
            words = "asserted required" if required else "no longer asserted required"
            self._tell(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    def assert_selected(self, element: ElementView | Element | Constraint | str, selected: bool | None) -> None:
        """State that a design or configuration is the selected one, or is not."""
        with self._lock:
            node = self._node(element, ("function design", "configuration"), unique=True)
            now = self._clock()
            self._known.selected[node.index] = selected is not None and _yes("selected", selected)
            words = "selected" if selected else "not selected"
            self._tell(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    @property
    def rejected(self) -> int:
        """How many parts of diagnostics could not be used so far."""
        return self._rejected

    @property
    def revision(self) -> int:
        """Grows whenever a fact changed that can matter to a planner: a measurement only if a status changed by it."""
        self._look_at_the_clock()
        return self._revision

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Have a function called with every event, in order; returns how to stop that.

        It is called by the thread that told, which holds the base meanwhile: it may ask and tell, but must not wait
        for another thread that does. What it raises is logged and reaches nobody else.
        """
        return self._publisher.subscribe(callback)

    def _history_of(self, attribute: Node) -> History:
        return self._measurements.history_of(attribute)

    def _look_at_the_clock(self) -> None:
        """Take note of what has become so with time since somebody last looked."""
        if self._measurements.next_change == math.inf or self._clock() < self._measurements.next_change:
            return
        with self._lock:
            now = self._clock()
            for node, text, touched in self._measurements.due(now):
                self._tell(EventKind.MONITORING_DATA, now, node, lambda told=text: told, touched, plain=True)  # type: ignore[misc]  # a default binds it now

    def _report(self, component: str, failed: bool) -> None:
        node = self.components.node(component)
        with self._lock:
            now, state = self._clock(), self._known
            retracts = not failed and state.asserted[node.index] is Status.FAILURE
            if retracts:
                state.asserted[node.index] = None
            elif state.failed[node.index] == failed:
                return
            state.failed[node.index] = failed
            words = "has failed" if failed else "is recovered"
            self._tell(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} {words}")

    def _assert_status(self, element: ElementView | Element | Constraint | str, status: Status | None) -> None:
        with self._lock:
            node = self._node(element, ELEMENTS, unique=True)
            if status is not None and status not in STATUSES[node.kind]:
                known = ", ".join(STATUSES[node.kind])
                raise InvalidValue(f"a {node.kind} is never {status!s}; it can be {known}")
            now = self._clock()
            self._known.asserted[node.index] = status
            words = f"asserted {status}" if status else "no longer asserted"
            self._tell(EventKind.MONITORING_DATA, now, node, lambda: f"{node.name} is {words}")

    def _tell(
        self,
        kind: EventKind,
        now: float,
        node: Node,
        text: Callable[[], str],
        touched: Collection[Node] | None = None,
        plain: bool = False,
    ) -> None:
        """Infer what follows from changed facts and publish it.

        Args:
            kind: of the event.
            now: the time [s].
            node: what the event is about.
            text: gives the event in words.
            touched: the nodes whose facts changed, if not the one that the event is about.
            plain: it matters only if a status changed by it.
        """
        nodes = [node] if touched is None else touched
        changes = settle(self._known, nodes)
        self._journal.enter(now, self._known, nodes)
        if changes or not plain:
            self._revision += 1
        if self._publisher:
            self._publisher.publish(Event(kind, now, node.name, text(), status_changes(changes)))

    def _reading(self, attribute: Node, value: float) -> str:
        return f"{attribute.name} is {shortest(value, self._network.thresholds(attribute).around(value))}"


def status_changes(changes: Iterable[Change]) -> tuple[StatusChange, ...]:
    """Name the elements whose statuses changed."""
    return tuple(StatusChange(node.kind, node.name, old, new) for node, old, new in changes)


def _yes(what: str, value: object) -> bool:
    if isinstance(value, bool):
        return value
    raise InvalidValue(f"{what} is True or False, not {value!r}")


def _measured(attribute: str, value: object) -> float:
    try:
        return finite_number(value)
    except InvalidValue as error:
        raise InvalidValue(f"{attribute} cannot be measured as {value!r}: {error}") from None
