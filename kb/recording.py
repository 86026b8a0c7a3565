"""What is put on record and changes no status: parameters in force, processes, attempts and answers about plans."""

from collections import deque
from collections.abc import Callable, Iterable
from types import MappingProxyType
from typing import Any, Final

from kb.declarations import parameters as checked_parameters
from kb.declarations import pid as checked_pid
from kb.declarations import text as checked_text
from kb.elements import Parameters
from kb.events import Event, Publisher, StatusChange
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.history import KEPT_RECORDS, Attempt, Process, VetoAnswer
from kb.inference.network import Network
from kb.inference.settling import Change, initial_state
from kb.inference.state import Reason
from kb.log import Log
from kb.questions import Questions
from kb.reconfiguration import ReconfigurationPlan
from kb.requests import check_result
from kb.status import Status
from kb.store.journal import Journal

__all__ = ["Recording"]

_OPERATIONS: Final = ("activate", "deactivate", "configure")


class Recording(Questions):
    """Everything that can be put on record, from any thread.

    Args:
        network: what depends on what.
        clock: gives the time [s].
    """

    def __init__(self, network: Network, clock: Callable[[], float]) -> None:
        super().__init__(network, clock)
        self._known = initial_state(network)
        self._journal = Journal(network.model)
        self._processes: list[Process] = []
        self._attempts: deque[Attempt] = deque(maxlen=KEPT_RECORDS)
        self._answers: deque[VetoAnswer] = deque(maxlen=KEPT_RECORDS)
        self._is_closed = False
        self._publisher = Publisher()
        self.log = Log()
        self._changed_by: dict[int, int] = {}
        self._attempt_numbers: dict[Attempt, int] = {}
        self._attempt_count = 0
        self._feasibility_changed: int | None = None
        self._plan_numbers: dict[ReconfigurationPlan, int] = {}

    def _happened(
        self,
        now: float,
        verb: str,
        arguments: tuple[Any, ...],
        words: Callable[[], str] | None = None,
        changes: Iterable[Change] = (),
        *,
        cause: int | None = None,
        plan: ReconfigurationPlan | None = None,
        effects: tuple[tuple[str, str, bool], ...] = (),
    ) -> int:
        """Enter an event in the log and publish it; returns its number."""
        number = self.log.last + 1
        changed = tuple(StatusChange(node.kind, node.name, old, new) for node, old, new in changes)
        for node, old, new in changes:
            self._changed_by[node.index] = number
            if node.kind == "action" and Status.UNFEASIBLE in (old, new):
                self._feasibility_changed = number
        event = Event(number, now, verb, arguments, changed, cause, effects, plan)
        self.log.append(event)
        if self._publisher:
            self._publisher.publish(event._replace(words=words()) if words else event)
        return number

    def component_configured(self, component: str, parameters: Parameters) -> None:
        """Tell which parameters a component was given; see `parameters_in_force` of its view."""
        node = self.components.node(component)
        with self._lock:
            self._check_open()
            self._in_force[node.name] = dict(checked_parameters(node.name, parameters))
            now = self._clock()
            self._journal.configured(now, node, self._in_force[node.name])
            self._happened(now, "component_configured", (node.name, MappingProxyType(self._in_force[node.name])))

    def component_started(self, component: str, pid: int) -> Process:
        """Tell that a component runs as a process of the operating system, whether it is active already or not."""
        node = self.components.node(component)
        checked_pid(pid)
        with self._lock:
            self._check_open()
            process = Process(node.name, pid, self._clock())
            self._processes.append(process)
            self._journal.enter(process.start, self._known, (), [process])
            self._happened(process.start, "component_started", (node.name, pid))
            return process

    def component_ended(self, component: str, pid: int | None = None) -> None:
        """Tell that the process of a component has ended: that of a number, or all of them."""
        node = self.components.node(component)
        if pid is not None:
            checked_pid(pid)
        with self._lock:
            self._check_open()
            now = self._clock()
            ended = [
                one
                for one in self._processes
                if one.component == node.name and one.end is None and pid in (None, one.pid)
            ]
            for process in ended:
                process._finish(now)
            self._journal.enter(now, self._known, (), ended)
            if ended:
                self._happened(now, "component_ended", (node.name, pid))

    @property
    def processes(self) -> tuple[Process, ...]:
        """Every process that a component ran as, in the order in which they were started."""
        with self._lock:
            return tuple(self._processes)

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
            configuration: name of what the component is to be configured with, None for a switch.
            parameters: what is to be set.
            number: 1 for the first time that the plan gives this command.
        """
        if operation not in _OPERATIONS:
            raise InvalidValue(f"{operation!r} is no operation; an operation is one of {', '.join(_OPERATIONS)}")
        name = self.components.node(component).name
        of = None if configuration is None else self.configurations.node(configuration).name
        given = MappingProxyType(dict(checked_parameters(name, parameters or {})))
        with self._lock:
            self._check_open()
            attempt = Attempt(self._plan(plan), name, operation, of, given, number, self._clock())
            self._attempts.append(attempt)
            self._journal.enter(attempt.start, self._known, (), [attempt])
            attempts = self._attempt_numbers
            attempts[attempt] = self._attempt_count = self._attempt_count + 1
            told = (self._plan_numbers.get(attempt.plan), name, operation, of, given, number)
            self._happened(attempt.start, "record_attempt", told, lambda: str(attempt))
            return attempt

    def finish_attempt(self, attempt: Attempt | int, result: str, reason: str = "") -> bool:
        """Put on record what came of a command; returns whether that was not known yet.

        Args:
            attempt: what `record_attempt` returned, or its number.
            result: "completed", "failed" or "abandoned".
            reason: why it failed, in words, or what was odd about it.
        """
        check_result(result)
        checked_text("the reason why an attempt ends", reason)
        with self._lock:
            self._check_open()
            if isinstance(attempt, int):
                attempt = next(one for one, number in self._attempt_numbers.items() if number == attempt)
            if attempt.end is not None:
                return False
            now = self._clock()
            attempt._finish(result, reason, now)
            self._journal.enter(now, self._known, (), [attempt])
            told = (self._attempt_numbers.get(attempt), result, reason)
            self._happened(now, "finish_attempt", told, lambda: str(attempt))
            return True

    def record_answer(self, plan: ReconfigurationPlan | int, is_vetoed: bool, reason: str = "") -> VetoAnswer:
        """Put on record what was answered about a plan before it was executed, and why it was forbidden if it was."""
        if not isinstance(is_vetoed, bool):
            raise InvalidValue(f"is_vetoed is True or False, not {is_vetoed!r}")
        checked_text("the reason of an answer", reason)
        with self._lock:
            self._check_open()
            answer = VetoAnswer(self._plan(plan), self._clock(), is_vetoed, reason)
            self._answers.append(answer)
            self._journal.enter(answer.time, self._known, (), [answer])
            told = (self._plan_numbers.get(answer.plan), is_vetoed, reason)
            words = "is vetoed" if is_vetoed else "may be executed"
            self._happened(answer.time, "record_answer", told, lambda: f"{answer.plan} {words}{Reason(reason)}")
            return answer

    def _plan(self, plan: object) -> ReconfigurationPlan:
        if isinstance(plan, ReconfigurationPlan):
            return plan
        found = next((one for one, number in self._plan_numbers.items() if number == plan), None)
        if found is None:
            raise InvalidValue(f"{plan!r} is no plan; give one of kb.plans")
        return found

    def _check_open(self) -> None:
        if self._is_closed:
            raise KnowledgeBaseError(
                "this knowledge base is closed: its store is given back, so nothing more can be told. "
                "Tell before you close it, or make a new one of the same model and store"
            )

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """The commands that were given, in order, with what came of each; the newest 10,000."""
        with self._lock:
            return tuple(self._attempts)

    @property
    def answers(self) -> tuple[VetoAnswer, ...]:
        """What was answered about plans before they were executed, in order; the newest 10,000."""
        with self._lock:
            return tuple(self._answers)
