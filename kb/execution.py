"""Carries out reconfiguration plans on the managed system, without waiting."""

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from kb.elements import ComponentKind, Configuration, is_number, whole
from kb.exceptions import InvalidValue, ProtocolError
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import (
    Looking,
    ManagedSystem,
    Operation,
    check_methods,
    look,
    words_of,
    wrong_answer,
)
from kb.network import Node
from kb.records import Attempt, ReconfigurationPlan
from kb.status import Status

_log = logging.getLogger(__name__)
_NOT_SET: Final = "its parameters could not be set"
"""How the reason of a configuration in quarantine begins."""


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all of them have
    ended. So a component gets its parameters before it starts. A command that fails or takes too
    long is repeated later; so is one that is reported done although the managed system denies it.
    When the last attempt fails, the commands to other components are still carried out, and the
    plan ends as failed. A configuration whose parameters cannot be set is in quarantine: it is
    asserted unfeasible until a hold is over or its component recovers. A component that cannot be
    switched is reported failed. So the planner chooses the next best. The executor stops again what
    the plan started for a function that has become unfeasible.

    After an interrupt, such as Ctrl-C within a call, the next turn records the commands under way
    as abandoned, and begins the plan's stages again; a command may then be given a second time.

    Args:
        managed: what is commanded; a plain component is not switched, only recorded as active or
            not.
        attempts: how many attempts a command has before it counts as failed.
        timeout: how long an attempt may take, in the time of the knowledge base's clock [s].
        timeout_by_component: the same for single components, by name [s].
        back_off: the pause after a failed attempt [s]; it doubles after each further failure.
        hold: how long a configuration that could not be set counts as unfeasible [s].
    """

    def __init__(
        self,
        managed: ManagedSystem,
        *,
        attempts: int = 3,
        timeout: float = 60.0,
        timeout_by_component: Mapping[str, float] | None = None,
        back_off: float = 0.5,
        hold: float = 300.0,
    ) -> None:
        check_methods("a managed system", managed, ManagedSystem, Looking)
        timeouts = dict(timeout_by_component or {})
        whole("the number of attempts", attempts)
        for seconds in (timeout, *timeouts.values()):
            if not is_number(seconds) or not seconds > 0:
                raise InvalidValue(
                    f"a time-out is more than 0 s, math.inf for none, not {seconds!r}"
                )
        if not is_number(back_off) or not 0 <= back_off < math.inf:
            raise InvalidValue(f"a back-off is a finite number of seconds from 0, not {back_off!r}")
        if not is_number(hold) or not hold >= 0:
            raise InvalidValue(f"a hold is 0 s or longer, math.inf for ever, not {hold!r}")
        self._managed = managed
        self._attempts = attempts
        self._timeout = timeout
        self._timeouts = timeouts
        self._back_off = back_off
        self._hold = hold
        self._kb: KnowledgeBase | None = None
        self._components: Mapping[str, Node] = {}
        self._configurations: Mapping[str, Node] = {}
        self._in_failure: set[str] = set()
        self._plan: ReconfigurationPlan | None = None
        self._stages: Iterator[list[_Command]] = iter(())
        self._stage: list[_Command] = []
        self._failed: set[str] = set()
        self._paused: list[str] = []
        self._is_under_way = False

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting.

        Raises:
            UnknownName: a time-out was given for a component that the model does not have; at the
                first turn only.
            ProtocolError: a method of the managed system or of an operation returned a value that
                the protocol does not allow; the command is abandoned, and given again at the next
                turn.
        """
        if self._is_under_way:
            self._abandon(kb)
        self._is_under_way = True
        if kb is not self._kb:
            self._kb = kb
            for name in self._timeouts:
                kb.components[name]
        self._release_recovered(kb)
        if self._plan is not None or self._begin(kb):
            self._advance(kb)
        self._is_under_way = False

    def _abandon(self, kb: KnowledgeBase) -> None:
        """Abandon the commands under way after an interrupt, and begin again."""
        reason = "it was interrupted before its answer was known"
        for command in self._stage:
            command.abandon(reason)
        for attempt in kb.history.attempts:
            if attempt.end is None:
                kb.finish_attempt(attempt, "abandoned", reason)
        self._begin(kb)

    def _begin(self, kb: KnowledgeBase) -> bool:
        """Begin with the latest open plan, if there is one."""
        plans = kb.history.open_plans
        if not plans or plans[-1] is not self._plan:
            self._failed = set()
            self._paused = []
        self._plan = plans[-1] if plans else None
        self._stage = []
        self._stages = self._staged(kb, plans)
        return bool(plans)

    def _advance(self, kb: KnowledgeBase) -> None:
        plan = self._plan
        if plan is None:
            return
        now = kb.now
        while True:
            self._stage = [command for command in self._stage if not self._has_ended(command, now)]
            if self._stage:
                return
            stage = None if plan.end is not None else next(self._stages, None)
            if stage is None:
                break
            self._stage = stage
        kb.finish_plan(plan, "failed" if self._failed else "completed")
        self._plan = None

    def _has_ended(self, command: "_Command", now: float) -> bool:
        """Advance a command and return whether it has ended; if so, record the result."""
        kb = command.kb
        configuration = command.configuration
        is_removed = configuration is not None and configuration.name not in self._configurations
        if is_removed or command.component not in self._components:
            command.abandon("it is no longer in the model")
            return True
        result = command.advance(now)
        if result == "failed":
            self._give_up(command)
        elif result and configuration is None:
            kb.component_active(command.component, command.operation == "activate")
        return result is not None

    def _give_up(self, command: "_Command") -> None:
        kb = command.kb
        component = command.component
        _log.warning("%s %s failed, %s", command.operation, component, command.reason)
        self._failed.add(component)
        if command.configuration is not None:
            configuration = kb.configurations[command.configuration.name]
            kb.assert_selected(configuration, False)  # it is not in force
            reason = f"{_NOT_SET}, {command.reason}"
            with suppress(InvalidValue):  # the hold is over already
                kb.assert_status(configuration, Status.UNFEASIBLE, reason, kb.now + self._hold)
            return
        is_active, _ = look(self._managed, component)
        if is_active is not None:
            kb.component_active(component, is_active)
        kb.component_failed(component, f"it could not be {command.operation}d, {command.reason}")

    def _release_recovered(self, kb: KnowledgeBase) -> None:
        """Release the configurations in quarantine of components that are in failure no more."""
        with kb.reading() as state:
            self._components = state.network.components
            self._configurations = state.network.configurations
            nodes = self._components.values()
            in_failure = {node.name for node in nodes if state.status[node] is Status.FAILURE}
            released = [
                part
                for node in nodes
                if node.name in self._in_failure - in_failure
                for part in node.requires
                if state.reason("asserted", part).text.startswith(_NOT_SET)
            ]
        for part in released:
            kb.retract_status(part.element)
        self._in_failure = in_failure

    # ---------------------------------------------------------------- the stages of a plan

    def _staged(
        self, kb: KnowledgeBase, plans: Sequence[ReconfigurationPlan]
    ) -> Iterator[list["_Command"]]:
        """Yield the stages of the latest open plan; each is decided when it begins.

        It includes what older open plans still have to do: they are abandoned when it completes.
        """
        plan = plans[-1]
        start = list(plan.activate)
        stop = list(plan.deactivate)
        parameters = list(plan.parameters)
        with kb.reading() as state:
            for older in plans[:-1]:
                parameters += older.parameters
                for node in self._nodes([*older.activate, *older.deactivate]):
                    is_active = node in state.active
                    if state.is_required(node) != is_active:
                        (stop if is_active else start).append(node.name)
            running = []
            for name in parameters:
                part = self._configurations.get(name)
                if part in state.selected and part.used_by[0] in state.active:
                    running.append(part.used_by[0])
        for node in running:
            if node.element.stops_to_configure and node.name not in (*stop, *self._paused):
                self._paused.append(node.name)
        started = [*start, *self._paused]
        yield self._switches(kb, plan, "deactivate", [*stop, *self._paused])
        yield self._configures(kb, plan, [*(node.name for node in running), *started])
        yield self._switches(kb, plan, "activate", started)
        if self._failed:
            yield self._rolled_back(kb, plan, started)

    def _nodes(self, names: Iterable[str]) -> list[Node]:
        """Return the components of these names, each once, that are still in the model."""
        unique = dict.fromkeys(names)
        return [self._components[name] for name in unique if name in self._components]

    def _switches(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, operation: str, names: Iterable[str]
    ) -> list["_Command"]:
        """Return commands to switch components; a failed one is only deactivated."""
        return [
            self._command(kb, plan, operation, node)
            for node in self._nodes(names)
            if operation == "deactivate" or node.name not in self._failed
        ]

    def _configures(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, names: Iterable[str]
    ) -> list["_Command"]:
        """Return commands to set the selected parameters."""
        commands = []
        with kb.reading() as state:
            for node in self._nodes(names):
                for part in node.requires:
                    if part in state.selected and node.name not in self._failed:
                        commands.append(self._command(kb, plan, "configure", node, part.element))
        return commands

    def _command(
        self,
        kb: KnowledgeBase,
        plan: ReconfigurationPlan,
        operation: str,
        node: Node,
        configuration: Configuration | None = None,
    ) -> "_Command":
        is_noted = configuration is None and node.element.kind is ComponentKind.PLAIN
        return _Command(
            kb,
            plan,
            None if is_noted else self._managed,
            node.name,
            operation,
            configuration,
            self._attempts,
            self._timeouts.get(node.name, self._timeout),
            self._back_off,
        )

    def _rolled_back(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, started: Sequence[str]
    ) -> list["_Command"]:
        """Stop and unselect what was started in vain: each plan would start it again."""
        commanded = {
            attempt.component
            for attempt in kb.history.attempts
            if attempt.plan is plan and attempt.operation == "activate"
        }
        idle = [
            name
            for name in started
            if name in commanded & self._failed and look(self._managed, name)[0] is not False
        ]
        in_vain: dict[Node, None] = {}
        nodes = self._nodes(started)
        with kb.reading() as state:
            for node in nodes:
                for design in state.users(node):
                    if state.status[design.used_by[0]] is Status.UNFEASIBLE:
                        in_vain[design] = None
        for design in in_vain:
            kb.assert_selected(design.element, False)
        with kb.reading() as state:
            for node in nodes:
                if node in state.active and not state.users(node):
                    idle.append(node.name)
        return self._switches(kb, plan, "deactivate", idle)


# -------------------------------------------------------------------- a command


@dataclass(slots=True, eq=False)
class _Command:
    """A command to one component, repeated until it is done or has failed for good.

    Attributes:
        managed: None for a plain component: nothing is commanded.
        operation: "activate", "deactivate" or "configure".
        configuration: None for a switch.
    """

    kb: KnowledgeBase
    plan: ReconfigurationPlan
    managed: ManagedSystem | None
    component: str
    operation: str
    configuration: Configuration | None
    attempts: int
    timeout: float
    back_off: float
    _attempt: Attempt | None = None
    _count: int = 0
    _due: float = -math.inf
    _operation: Operation | None = None
    _refusal: Exception | None = None

    @property
    def reason(self) -> str:
        """The number of attempts and the result of the last one, in words."""
        tried = {1: "once", 2: "twice"}.get(self._count, f"{self._count} times")
        return f"tried {tried}: {self._attempt.reason if self._attempt else ''}"

    def advance(self, now: float) -> str | None:
        """Return "completed" or "failed" once the command has ended, None before."""
        if self.managed is None:
            return "completed"
        while True:
            attempt = self._attempt
            try:
                if attempt is None or attempt.end is not None:
                    if now < self._due:
                        return None
                    attempt = self._begin(self.managed)
                outcome = self._outcome(self.managed, now - attempt.start)
            except ProtocolError as mistake:
                self.abandon(str(mistake))
                raise
            if outcome is None:
                return None
            result, reason = outcome
            self.kb.finish_attempt(attempt, result, reason)
            if result == "completed" or self._count >= self.attempts:
                return result
            self._due = now + self.back_off * 2.0 ** min(self._count - 1, 60)

    def abandon(self, reason: str) -> None:
        """Cancel the operation that is under way, if any."""
        if self._attempt is not None and self._attempt.end is None:
            self._cancel()
            self.kb.finish_attempt(self._attempt, "abandoned", reason)

    def _begin(self, managed: ManagedSystem) -> Attempt:
        """Record an attempt and give the command."""
        name = self.component
        configuration = self.configuration
        self._count += 1
        self._operation = None
        self._refusal = None
        self._attempt = attempt = self.kb.record_attempt(
            self.plan,
            name,
            self.operation,
            None if configuration is None else configuration.name,
            None if configuration is None else configuration.parameters,
            self._count,
        )
        try:
            if configuration is not None:
                answer = managed.set_parameters(name, configuration.parameters)
                call = f"set_parameters({name!r}, ...)"
            else:
                is_start = self.operation == "activate"
                answer = managed.activate(name) if is_start else managed.deactivate(name)
                call = f"{self.operation}({name!r})"
            self._operation = operation = answer
            if operation is not None and not all(
                callable(getattr(operation, name, None)) for name in ("done", "exception")
            ):
                expected = "None if it is done, or an operation with done() and exception()"
                raise wrong_answer(call, managed, operation, expected)
        except ProtocolError:
            raise
        except Exception as error:
            self._refusal = error
        return attempt

    def _outcome(self, managed: ManagedSystem, duration: float) -> tuple[str, str] | None:
        """Return the result of the attempt and its reason, or None while it is under way."""
        has_ended, error = self._progress()
        is_late = duration >= self.timeout
        if error is not None:
            return "failed", words_of(error)
        if not has_ended and not is_late:
            return None
        is_reached = None
        doubt = f"{self.component} was not in that state"
        if self.configuration is None:  # whether parameters are in force cannot be asked
            is_active, trouble = look(managed, self.component)
            if is_active is not None:
                is_reached = is_active is (self.operation == "activate")
            if trouble:
                is_reached = False
                doubt = f"its state could not be read ({trouble})"
        if has_ended and is_reached is not False:
            return "completed", ""
        if not is_late:
            return None
        if is_reached:
            return "completed", "it was never reported done, but it is"
        if has_ended:
            return "failed", f"it was reported done, but {doubt} within {self.timeout:g} s"
        self._cancel()
        return "failed", f"it was not done within {self.timeout:g} s"

    def _progress(self) -> tuple[bool, BaseException | None]:
        """Return whether the operation has ended, and its error."""
        operation = self._operation
        if operation is None:
            return True, self._refusal
        try:
            has_ended = operation.done()
            error = operation.exception() if has_ended is True else None
        except Exception as error:
            return True, error
        if not isinstance(has_ended, bool):
            raise wrong_answer("done()", operation, has_ended, "True or False")
        if error is None or isinstance(error, BaseException):
            return has_ended, error
        expected = "what went wrong, as an exception, or None"
        raise wrong_answer("exception()", operation, error, expected)

    def _cancel(self) -> None:
        """Cancel the operation if it can be cancelled, so that it does not take effect later."""
        try:
            getattr(self._operation, "cancel", lambda: None)()
        except Exception as error:
            _log.warning("an operation could not be cancelled: %s", words_of(error))
