"""Carries out reconfiguration plans on the managed system, without waiting."""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from kb.elements import Component, ComponentKind, Configuration, is_number, whole
from kb.exceptions import InvalidValue
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import ManagedSystem, check_methods, look, words_of, wrong_answer
from kb.network import Network, Node
from kb.records import Attempt, ReconfigurationPlan
from kb.state import State
from kb.status import Status

_METHODS: Final = {
    "deactivate": "deactivate",
    "configure": "set_parameters",
    "activate": "activate",
}


@dataclass(slots=True, eq=False)
class _Command:
    """A command to one component, repeated until it is done or has failed for good.

    Attributes:
        configuration: None for a switch.
        attempt: the latest one.
        answer: the operation under way, the error of the call, or None if it was done at once.
        count: how many attempts were made.
        pause: before the next attempt [s].
        due: when the next attempt is made [s].
    """

    component: Component
    operation: str
    configuration: Configuration | None
    pause: float
    attempt: Attempt | None = None
    answer: Any = None
    count: int = 0
    due: float = -math.inf

    def cancel(self) -> None:
        """Cancel the operation under way if it can be, so that it does not take effect later."""
        cancel = getattr(self.answer, "cancel", None)
        if cancel is not None:
            with suppress(Exception):
                cancel()


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all of them have
    ended. So a component gets its parameters before it starts. A command that fails or takes too
    long is repeated later; so is one that is reported done although the managed system denies it.
    When the last attempt fails, the commands to other components are still carried out, and the
    plan ends as failed. A configuration whose parameters cannot be set is asserted unfeasible
    until a hold is over. A component that cannot be switched is reported failed. So the planner
    chooses the next best. A design is unselected if its function has become unfeasible.

    After an interrupt, such as Ctrl-C within a call, the next turn records the commands under way
    as abandoned, and begins the plan's stages again; a command may then be given a second time.
    So it does when the model changes, or when a later plan is made.

    Args:
        managed: what is commanded; a plain component is not switched, only recorded as active or
            not.
        attempts: how many attempts a command has before it counts as failed.
        timeout: how long an attempt may take, in the time of the knowledge base's clock [s].
        back_off: the pause after a failed attempt [s]; it doubles after each further failure.
        hold: how long a configuration that could not be set counts as unfeasible [s].
    """

    def __init__(
        self,
        managed: ManagedSystem,
        *,
        attempts: int = 3,
        timeout: float = 60.0,
        back_off: float = 0.5,
        hold: float = 300.0,
    ) -> None:
        check_methods("a managed system", managed, ManagedSystem)
        whole("the number of attempts", attempts)
        for name, seconds in (("timeout", timeout), ("back_off", back_off), ("hold", hold)):
            if not is_number(seconds) or not seconds >= 0:
                raise InvalidValue(f"{name} is a time from 0 s, not {seconds!r}")
        self._managed = managed
        self._attempts = attempts
        self._timeout = timeout
        self._back_off = back_off
        self._hold = hold
        self._plan: ReconfigurationPlan | None = None
        self._network: Network | None = None
        self._stages: list[list[_Command]] = []
        self._stage: list[_Command] = []
        self._failed: set[str] = set()
        self._paused: list[str] = []
        self._is_under_way = False

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting.

        Raises:
            ProtocolError: a method of the managed system returned a value that the protocol does
                not allow; the command is abandoned, and given again at the next turn.
        """
        plans = kb.history.open_plans
        plan = plans[-1] if plans else None
        commands = self._stage
        with kb.reading() as state:
            is_new = plan is not self._plan or state.network is not self._network
            if is_new or self._is_under_way:
                self._begin(state, plans)
        is_to_abandon = self._is_under_way or (is_new and commands)
        self._is_under_way = True
        if is_to_abandon:
            self._abandon(kb, commands)
        if plan is not None:
            self._advance(kb, plan)
        self._is_under_way = False

    def _abandon(self, kb: KnowledgeBase, commands: Iterable[_Command]) -> None:
        """Cancel commands, and end all attempts; the base is not held, for that may take time."""
        for command in commands:
            command.cancel()
        for attempt in kb.history.attempts:
            if attempt.end is None:
                reason = "it was interrupted before its answer was known"
                kb.finish_attempt(attempt, "abandoned", reason)

    def _begin(self, state: State, plans: Sequence[ReconfigurationPlan]) -> None:
        """Begin with the stages of the latest plan."""
        plan = plans[-1] if plans else None
        if plan is not self._plan:
            self._failed = set()
            self._paused = []
        self._plan = plan
        self._network = state.network
        self._stage = []
        if plan is None:
            return
        start = list(plan.activate)
        stop = list(plan.deactivate)
        for older in plans[:-1]:  # completing this plan abandons them
            for name in (*older.activate, *older.deactivate):
                node = state.network.components[name]
                if state.is_required(node) is not (node in state.active):
                    (stop if node in state.active else start).append(name)
        running = []
        for name in [name for open_plan in plans for name in open_plan.parameters]:
            part = state.network.configurations[name]
            owner = part.used_by[0]
            if part in state.selected and owner in state.active:
                running.append(owner.name)
                if owner.element.stops_to_configure:
                    self._paused.append(owner.name)
        self._paused = [name for name in self._paused if name not in stop]
        started = [*start, *self._paused]
        self._stages = [
            self._commands(state, "deactivate", [*stop, *self._paused]),
            self._commands(state, "configure", [*running, *started]),
            self._commands(state, "activate", started),
        ]

    def _commands(self, state: State, operation: str, names: Iterable[str]) -> list[_Command]:
        """Return commands to components."""
        commands = []
        for name in dict.fromkeys(names):
            node = state.network.components[name]
            configurations: list[Configuration | None] = [None]
            if operation == "configure":
                parts = [part for part in node.requires if part in state.selected]
                configurations = [part.element for part in parts]
            for configuration in configurations:
                command = _Command(node.element, operation, configuration, self._back_off)
                commands.append(command)
        return commands

    def _advance(self, kb: KnowledgeBase, plan: ReconfigurationPlan) -> None:
        now = kb.now
        while True:
            self._stage = [
                command for command in self._stage if not self._has_ended(kb, plan, command, now)
            ]
            if self._stage:
                return
            if not self._stages:
                break
            self._stage = [
                command
                for command in self._stages.pop(0)
                if command.operation == "deactivate" or command.component.name not in self._failed
            ]
        if self._failed:
            self._give_up_designs(kb, plan)
        kb.finish_plan(plan, "failed" if self._failed else "completed")

    def _give_up_designs(self, kb: KnowledgeBase, plan: ReconfigurationPlan) -> None:
        """Unselect what was started in vain: each plan would start it again."""
        in_vain: dict[Node, None] = {}
        with kb.reading() as state:
            for name in plan.activate:
                for design in state.users(state.network.components[name]):
                    if state.status[design.used_by[0]] is Status.UNFEASIBLE:
                        in_vain[design] = None
        for design in in_vain:
            kb.assert_selected(design.element, False)

    # ---------------------------------------------------------------- a command

    def _has_ended(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, command: _Command, now: float
    ) -> bool:
        """Give a command if it is due, take in its result, and return whether it has ended."""
        is_switch = command.configuration is None
        name = command.component.name
        result = "completed"
        reason = ""
        while not (is_switch and command.component.kind is ComponentKind.PLAIN):
            attempt = command.attempt
            if attempt is None or attempt.end is not None:
                if now < command.due:
                    return False
                attempt = self._give(kb, plan, command)
            outcome = self._outcome(command, now - attempt.start)
            if outcome is None:
                return False
            result, reason = outcome
            kb.finish_attempt(attempt, result, reason)
            if result == "completed" or command.count >= self._attempts:
                break
            command.due = now + command.pause
            command.pause *= 2.0
        if result == "failed":
            self._failed.add(name)
            self._give_up(kb, command, f"{reason} (attempt {command.count} of {self._attempts})")
        elif is_switch:
            kb.component_active(name, command.operation == "activate")
        return True

    def _give(self, kb: KnowledgeBase, plan: ReconfigurationPlan, command: _Command) -> Attempt:
        """Record an attempt and give the command."""
        name = command.component.name
        operation = command.operation
        configuration = command.configuration
        part = None
        parameters = None
        arguments: tuple[Any, ...] = (name,)
        if configuration is not None:
            part = configuration.name
            parameters = configuration.parameters
            arguments = (name, parameters)
        command.count += 1
        command.attempt = attempt = kb.record_attempt(
            plan, name, operation, part, parameters, command.count
        )
        method = _METHODS[operation]
        try:
            command.answer = getattr(self._managed, method)(*arguments)
        except Exception as error:
            command.answer = error
            return attempt
        is_operation = hasattr(command.answer, "done") and hasattr(command.answer, "exception")
        if command.answer is not None and not is_operation:
            expected = "None if it is done, or an operation with done() and exception()"
            raise wrong_answer(f"{method}({name!r})", self._managed, command.answer, expected)
        return attempt

    def _outcome(self, command: _Command, duration: float) -> tuple[str, str] | None:
        """Return the result of the latest attempt and its reason; None while it is under way."""
        answer = command.answer
        error = answer if isinstance(answer, Exception) else None
        has_ended = True
        if answer is not None and error is None:
            try:
                has_ended = answer.done()
                error = answer.exception() if has_ended else None
            except Exception as problem:
                error = problem
        if error is not None:
            return "failed", words_of(error)
        is_reached = has_ended
        if has_ended and command.configuration is None:  # whether parameters hold cannot be asked
            is_active, trouble = look(self._managed, command.component.name)
            is_reached = not trouble and is_active in (None, command.operation == "activate")
        if is_reached:
            return "completed", ""
        if duration < self._timeout:
            return None
        command.cancel()
        if has_ended:
            doubt = f"reported done, but {command.component.name} was not in that state"
        else:
            doubt = "not done"
        return "failed", f"it was {doubt} within {self._timeout:g} s"

    def _give_up(self, kb: KnowledgeBase, command: _Command, reason: str) -> None:
        """Report a component failed, or hold its configuration, so that another is chosen."""
        configuration = command.configuration
        if configuration is None:
            words = f"it could not be {command.operation}d: {reason}"
            kb.component_failed(command.component.name, words)
            return
        kb.assert_selected(configuration, False)  # it is not in force
        words = f"its parameters could not be set: {reason}"
        with suppress(InvalidValue):  # the hold is over already
            kb.assert_status(configuration, Status.UNFEASIBLE, words, kb.now + self._hold)
