"""What is put on record and changes no status: parameters in force, processes, attempts and answers about plans."""

from collections import deque
from collections.abc import Callable
from types import MappingProxyType
from typing import Final

from kb.declarations import parameters as checked_parameters
from kb.declarations import pid as checked_pid
from kb.declarations import text as checked_text
from kb.elements import Parameters
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.history import KEPT_RECORDS, Attempt, Process, VetoAnswer
from kb.inference.network import Network
from kb.inference.settling import initial_state
from kb.questions import Questions
from kb.reconfiguration import ReconfigurationPlan
from kb.requests import check_result
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

    def component_configured(self, component: str, parameters: Parameters) -> None:
        """Tell which parameters a component was given; see `parameters_in_force` of its view."""
        node = self.components.node(component)
        with self._lock:
            self._check_open()
            self._in_force[node.name] = dict(checked_parameters(node.name, parameters))
            self._journal.configured(self._clock(), node, self._in_force[node.name])

    def component_started(self, component: str, pid: int) -> Process:
        """Tell that a component runs as a process of the operating system, whether it is active already or not."""
        node = self.components.node(component)
        checked_pid(pid)
        with self._lock:
            self._check_open()
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
            self._check_open()
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

    def record_attempt(
        self,
        plan: ReconfigurationPlan,
        component: str,
        operation: str,
        *,
        configuration: str | None = None,
        parameters: Parameters | None = None,
        number: int = 1,
    ) -> Attempt:
        """Put on record that a command is given now; `finish_attempt` tells what came of it.

        Args:
            plan: what it is part of; one of `plans`.
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
            attempt = Attempt(_checked_plan(plan), name, operation, of, given, number, self._clock())
            self._attempts.append(attempt)
            self._journal.enter(attempt.start, self._known, (), [attempt])
            return attempt

    def finish_attempt(self, attempt: Attempt, result: str, reason: str = "") -> bool:
        """Put on record what came of a command; returns whether that was not known yet.

        Args:
            attempt: what `record_attempt` returned.
            result: "completed", "failed" or "abandoned".
            reason: why it failed, in words, or what was odd about it.
        """
        check_result(result)
        checked_text("the reason why an attempt ends", reason)
        with self._lock:
            self._check_open()
            if attempt.end is not None:
                return False
            now = self._clock()
            attempt._finish(result, reason, now)
            self._journal.enter(now, self._known, (), [attempt])
            return True

    def record_answer(self, plan: ReconfigurationPlan, *, is_vetoed: bool, reason: str = "") -> VetoAnswer:
        """Put on record what was answered about a plan before it was executed, and why it was forbidden if it was."""
        if not isinstance(is_vetoed, bool):
            raise InvalidValue(f"is_vetoed is True or False, not {is_vetoed!r}")
        checked_text("the reason of an answer", reason)
        with self._lock:
            self._check_open()
            answer = VetoAnswer(_checked_plan(plan), self._clock(), is_vetoed, reason)
            self._answers.append(answer)
            self._journal.enter(answer.time, self._known, (), [answer])
            return answer

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


def _checked_plan(plan: object) -> ReconfigurationPlan:
    if isinstance(plan, ReconfigurationPlan):
        return plan
    raise InvalidValue(f"{plan!r} is no plan; give one of kb.plans")
