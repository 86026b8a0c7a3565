"""Carries out reconfiguration plans on the managed system, without waiting."""

import logging
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from typing import NamedTuple

from kb.elements import ComponentKind, Configuration, finite_number, is_number, whole
from kb.exceptions import InvalidValue, ProtocolError
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import (
    ManagedSystem,
    Operation,
    check_methods,
    look,
    operation_of,
    words_of,
    wrong_answer,
)
from kb.network import Node
from kb.records import Attempt, ReconfigurationPlan
from kb.state import State
from kb.status import Status

_log = logging.getLogger(__name__)


class RetryPolicy(NamedTuple):
    """How many attempts a command has, the time of each [s], and the first pause [s]."""

    attempts: int
    timeout: float
    back_off: float


class Budgets:
    """The most that what is selected and active may use, by name of attribute."""

    def __init__(self, budgets: Mapping[str, float] | None) -> None:
        if not isinstance(budgets, Mapping | None):
            raise InvalidValue(
                f"budgets are given as the most by name of attribute, not as {budgets!r}"
            )
        self.most = {name: finite_number(limit) for name, limit in (budgets or {}).items()}

    def allow(self, kb: KnowledgeBase, started: Collection[str], failed: Collection[str]) -> bool:
        """Return whether the budgets hold once the selection is carried out.

        Then the components `started` are active too, and those that `failed` keep their old
        parameters.
        """
        loads = self._loads(kb, started, failed)
        return all(load <= Decimal(repr(self.most[name])) for name, load in loads.items())

    def are_eased(self, kb: KnowledgeBase, component: str, failed: Collection[str]) -> bool:
        """Return whether a component uses no more with its new parameters."""
        after = self._loads(kb, (), failed)
        before = self._loads(kb, (), {*failed, component})
        return all(load <= before[name] for name, load in after.items())

    def _loads(
        self, kb: KnowledgeBase, started: Collection[str], failed: Collection[str]
    ) -> dict[str, Decimal]:
        loads = dict.fromkeys(self.most, Decimal())
        with kb.reading() as state:
            for estimation in state.network.model.estimations:
                if estimation.attribute not in loads:
                    continue
                if _counts(kb, state, state.network.find(estimation.causer), started, failed):
                    loads[estimation.attribute] += Decimal(repr(estimation.adds))
        return loads


def _counts(
    kb: KnowledgeBase, state: State, causer: Node, started: Collection[str], failed: Collection[str]
) -> bool:
    """Return whether an estimation counts: it is of what is selected and active."""
    if causer.kind == "function design":
        return causer in state.selected
    component = causer if causer.kind == "component" else causer.used_by[0]
    if component.name not in started and component not in state.active:
        return False
    if causer is component:
        return True
    is_configured = any(part in state.selected for part in component.requires)
    if is_configured and component.name not in failed:
        return causer in state.selected
    in_force = kb.components[component.name].parameters_in_force
    return dict(in_force) == dict(causer.element.parameters)


class Quarantine:
    """Configurations that failed: each is asserted unfeasible until a hold [s] is over.

    Attributes:
        components: the component of each configuration in quarantine, by name; up to date after
            `review`.
    """

    def __init__(self, hold: float) -> None:
        if not is_number(hold) or not hold >= 0:
            raise InvalidValue(f"a hold is 0 s or longer, math.inf for ever, not {hold!r}")
        self._hold = hold
        self.components: dict[str, str] = {}
        self._failed: set[str] = set()

    def put(self, kb: KnowledgeBase, configuration: str, reason: str) -> None:
        """Assert that a configuration is unfeasible, and unselect it: it is not in force."""
        view = kb.configurations[configuration]
        kb.assert_selected(view, False)
        with suppress(InvalidValue):  # the hold is over already
            kb.assert_status(view, Status.UNFEASIBLE, reason, kb.now + self._hold)
        self.components[configuration] = view.component

    def adopt(self, kb: KnowledgeBase) -> None:
        """Find what was in quarantine when the knowledge base was last closed."""
        latest: dict[str, Attempt] = {}
        for attempt in kb.history.attempts:
            if attempt.configuration is not None:
                latest[attempt.configuration] = attempt
        for name, attempt in latest.items():
            if attempt.result == "failed":
                self.components[name] = attempt.component
        self.review(kb)

    def review(self, kb: KnowledgeBase) -> None:
        """Release what has recovered, and forget what is asserted no longer."""
        if not self.components:
            return
        asserted = {}
        failed = set()
        with kb.reading() as state:
            for name, component in self.components.items():
                node = state.network.configurations.get(name)
                if node is None or state.asserted.get(node) is not Status.UNFEASIBLE:
                    continue
                asserted[name] = component
                if state.status[node.used_by[0]] is Status.FAILURE:
                    failed.add(component)
        recovered = self._failed - failed
        for name, component in asserted.items():
            if component in recovered:
                kb.retract_status(kb.configurations[name])
        self.components = {
            name: component for name, component in asserted.items() if component not in recovered
        }
        self._failed = failed


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all of them have
    ended. So a component gets its parameters before it starts. A command that fails or takes too
    long is repeated later; so is one that is reported done although the managed system denies it.
    When the last attempt fails, the commands to other components are still carried out, and the
    plan ends as failed. A configuration whose parameters cannot be set goes into quarantine, a
    component that cannot be switched is reported failed; so the planner chooses the next best. The
    executor stops again what the plan started for a function that has become unfeasible.

    After an interrupt, such as Ctrl-C within a call, the next turn records commands without a
    known answer as abandoned, and begins the plan's stages again; a command may then be given a
    second time.

    Args:
        managed: what is commanded; a plain component is not switched, only recorded as active or
            not.
        attempts: how many attempts a command has before it counts as failed.
        timeout: how long an attempt may take, in the time of the knowledge base's clock [s].
        timeout_by_component: the same for single components, by name [s].
        back_off: the pause after a failed attempt [s]; it doubles after each further failure.
        hold: how long a configuration that could not be set counts as unfeasible [s].
        budgets: the most that what is selected and active may use by estimation, by name of
            attribute, also during a plan: active components get their parameters one after the
            other, and the rest of a plan is not carried out if it might exceed a budget because
            something failed.
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
        budgets: Mapping[str, float] | None = None,
    ) -> None:
        check_methods("a managed system", managed, ManagedSystem, ("is_active(component)",))
        timeouts = dict(timeout_by_component or {})
        whole("the number of attempts", attempts)
        for seconds in (timeout, *timeouts.values()):
            if not is_number(seconds) or not seconds > 0:
                raise InvalidValue(
                    f"a time-out is more than 0 s, math.inf for none, not {seconds!r}"
                )
        if not is_number(back_off) or not 0 <= back_off < math.inf:
            raise InvalidValue(f"a back-off is a finite number of seconds from 0, not {back_off!r}")
        self._managed = managed
        self._policy = RetryPolicy(attempts, timeout, back_off)
        self._policies = {
            name: RetryPolicy(attempts, seconds, back_off) for name, seconds in timeouts.items()
        }
        self._quarantine = Quarantine(hold)
        self._budgets = Budgets(budgets)
        self._kb: KnowledgeBase | None = None
        self._plan: ReconfigurationPlan | None = None
        self._stages: Iterator[list[_Command]] = iter(())
        self._stage: list[_Command] = []
        self._failed: set[str] = set()
        self._paused: list[str] = []
        self._is_under_way = False

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting.

        Raises:
            UnknownName: a time-out was given for a component, or a budget for an attribute, that
                the model does not have; at the first turn only.
            ProtocolError: a method of the managed system or of an operation returned a value that
                the protocol does not allow; the command is abandoned, and given again at the next
                turn.
        """
        if self._is_under_way and self._plan is not None:
            self._begin_again(kb, self._plan)
        self._is_under_way = True
        if kb is not self._kb:
            self._adopt(kb)
        self._quarantine.review(kb)
        self._advance(kb)
        self._is_under_way = False

    def _begin_again(self, kb: KnowledgeBase, plan: ReconfigurationPlan) -> None:
        """Abandon attempts without a known answer after an interrupt, and begin again."""
        answered = [command.attempt for command in self._stage if command.is_answered]
        for attempt in kb.history.attempts:
            if attempt.end is None and attempt.plan is plan and attempt not in answered:
                reason = "it was interrupted before its answer was known"
                kb.finish_attempt(attempt, "abandoned", reason)
        plans = kb.history.open_plans
        if plan not in plans:
            self._stages = iter(())
            return
        self._stages = self._staged(kb, plans)
        if plan is not plans[-1]:  # the latest carries what the older ones still have to do
            self._plan = plans[-1]
            self._failed = set()
            self._stage = [command for command in self._stage if command.is_under_way]

    def _adopt(self, kb: KnowledgeBase) -> None:
        self._quarantine.adopt(kb)
        self._kb = kb
        for name in self._policies:
            kb.components[name]
        for name in self._budgets.most:
            kb.attributes[name]

    def _advance(self, kb: KnowledgeBase) -> None:
        if self._plan is None:
            plans = kb.history.open_plans
            if not plans:
                return
            self._stages = self._staged(kb, plans)
            self._stage = []
            self._failed = set()
            self._paused = []
            self._plan = plans[-1]
        self._drop_removed(kb)
        now = kb.now
        while True:
            self._stage = [
                command for command in self._stage if not self._has_ended(kb, command, now)
            ]
            if self._stage:
                return
            following = None if self._plan.end is not None else next(self._stages, None)
            if following is None:
                break
            self._stage = following
            for command in following:
                command.begin(now)
        kb.finish_plan(self._plan, "failed" if self._failed else "completed")
        self._plan = None

    def _drop_removed(self, kb: KnowledgeBase) -> None:
        """Abandon the commands whose component or configuration is no longer in the model."""
        for command in tuple(self._stage):
            configuration = command.configuration
            is_there = configuration is None or configuration.name in kb.configurations
            if not is_there or command.component not in kb.components:
                command.abandon("it is no longer in the model")
                self._stage.remove(command)

    def _has_ended(self, kb: KnowledgeBase, command: "_Command", now: float) -> bool:
        """Advance a command and return whether it has ended; if so, record the result."""
        result = command.advance(now)
        if result is None:
            return False
        if result == "failed":
            self._give_up(kb, command)
        elif command.configuration is None:
            kb.component_active(command.component, command.operation == "activate")
        return True

    def _give_up(self, kb: KnowledgeBase, command: "_Command") -> None:
        component = command.component
        _log.warning("%s %s failed, %s", command.operation, component, command.reason)
        self._failed.add(component)
        if command.configuration is not None:
            reason = f"its parameters could not be set, {command.reason}"
            self._quarantine.put(kb, command.configuration.name, reason)
            return
        is_active, _ = look(self._managed, component)
        if is_active is not None:
            kb.component_active(component, is_active)
        kb.component_failed(component, f"it could not be {command.operation}d, {command.reason}")

    # ---------------------------------------------------------------- the stages of a plan

    def _staged(
        self, kb: KnowledgeBase, plans: Sequence[ReconfigurationPlan]
    ) -> Iterator[list["_Command"]]:
        """Yield the stages of the latest open plan; each is decided when it begins."""
        plan = plans[-1]
        with kb.reading() as state:
            steps = _Steps.of(state, plans)
            running = _running(state, steps.configurations)
        paused = [name for name, node in running.items() if node.element.stops_to_configure]
        self._paused += [name for name in paused if name not in (*steps.stop, *self._paused)]
        started = [*steps.start, *self._paused]
        stopped = [*steps.stop, *self._paused]
        if stopped:
            yield self._switches(kb, plan, "deactivate", stopped)
        if self._budgets.most:
            yield from self._configured_within_budgets(kb, plan, steps.configurations, started)
            yield self._configures(kb, plan, started, ())
        else:
            yield self._configures(kb, plan, started, steps.configurations)
        if started:
            yield self._switches(kb, plan, "activate", started)
        if self._failed:
            yield self._rolled_back(kb, plan, started)

    def _configured_within_budgets(
        self,
        kb: KnowledgeBase,
        plan: ReconfigurationPlan,
        configurations: Sequence[str],
        started: Sequence[str],
    ) -> Iterator[list["_Command"]]:
        """Configure active components one by one, first those that use no more than before.

        A component that might exceed a budget, because another one has failed, is neither
        configured nor started.
        """
        with kb.reading() as state:
            running = _running(state, configurations)
        eased = [name for name in running if self._budgets.are_eased(kb, name, self._failed)]
        for name in (*eased, *(name for name in running if name not in eased)):
            if name in eased or self._budgets.allow(kb, started, self._failed):
                yield self._configures(kb, plan, [name], ())
                continue
            self._failed.add(name)
            chosen = kb.components[name].selected_configuration
            if chosen is not None:
                self._quarantine.put(kb, chosen, "with its parameters a budget might be exceeded")
        if not self._budgets.allow(kb, started, self._failed):
            self._failed.update(started)

    def _switches(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, operation: str, names: Iterable[str]
    ) -> list["_Command"]:
        """Return commands to switch components; a failed one is only deactivated."""
        with kb.reading() as state:
            nodes = _in_model(state, names)
        commands = []
        for name, node in nodes.items():
            if operation == "activate" and name in self._failed:
                continue
            managed = None if node.element.kind is ComponentKind.PLAIN else self._managed
            policy = self._policies.get(name, self._policy)
            commands.append(_Command(kb, plan, policy, managed, name, operation))
        return commands

    def _configures(
        self,
        kb: KnowledgeBase,
        plan: ReconfigurationPlan,
        names: Iterable[str],
        configurations: Iterable[str],
    ) -> list["_Command"]:
        """Return commands to set the selected parameters."""
        selected: dict[str, Configuration] = {}
        with kb.reading() as state:
            running = _running(state, configurations)
            for name, node in _in_model(state, [*running, *names]).items():
                for part in node.requires:
                    if part in state.selected and name not in self._failed:
                        selected[name] = part.element
        return [
            _Command(
                kb,
                plan,
                self._policies.get(name, self._policy),
                self._managed,
                name,
                "configure",
                configuration,
            )
            for name, configuration in selected.items()
        ]

    def _rolled_back(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, started: Sequence[str]
    ) -> list["_Command"]:
        """Stop and unselect what was started in vain: each plan would start it again."""
        commanded = {
            attempt.component
            for attempt in kb.history.attempts
            if attempt.plan is plan and attempt.operation == "activate"
        }
        unsure = [
            name
            for name in started
            if name in commanded & self._failed and look(self._managed, name)[0] is not False
        ]
        with kb.reading() as state:
            nodes = _in_model(state, started).values()
            designs = {
                design for node in nodes for design in node.used_by if design in state.selected
            }
            in_vain = [
                design
                for design in sorted(designs, key=lambda design: design.index)
                if state.status[design.used_by[0]] is Status.UNFEASIBLE
            ]
        for design in in_vain:
            kb.assert_selected(design.element, False)
        with kb.reading() as state:
            idle = [
                name
                for name, node in _in_model(state, started).items()
                if node in state.active
                and not any(design in state.selected for design in node.used_by)
            ]
        return self._switches(kb, plan, "deactivate", [*unsure, *idle])


class _Steps(NamedTuple):
    """The names of components to start and to stop, and of configurations to set."""

    start: list[str]
    stop: list[str]
    configurations: list[str]

    @classmethod
    def of(cls, state: State, plans: Sequence[ReconfigurationPlan]) -> "_Steps":
        """Return the latest plan's steps, and what older open plans still have to do.

        The older plans are abandoned when the latest completes.
        """
        plan = plans[-1]
        steps = cls(list(plan.activate), list(plan.deactivate), list(plan.parameters))
        configurations = state.network.configurations
        for older in plans[:-1]:
            for name, node in _in_model(state, [*older.activate, *older.deactivate]).items():
                is_active = node in state.active
                if state.is_required(node) != is_active:
                    (steps.stop if is_active else steps.start).append(name)
            for name in older.parameters:
                if name in configurations and configurations[name] in state.selected:
                    steps.configurations.append(name)
        return steps


def _in_model(state: State, names: Iterable[str]) -> dict[str, Node]:
    components = state.network.components
    return {name: components[name] for name in names if name in components}


def _running(state: State, configurations: Iterable[str]) -> dict[str, Node]:
    """Return the components of configurations that are in the model and active."""
    nodes = state.network.configurations
    components = [nodes[name].used_by[0] for name in configurations if name in nodes]
    return {node.name: node for node in components if node in state.active}


# -------------------------------------------------------------------- a command


@dataclass(slots=True, eq=False)
class _Command:
    """A command to one component, repeated until it is done or has failed for good.

    Attributes:
        managed: None for a plain component: nothing is commanded.
        operation: "activate", "deactivate" or "configure".
        configuration: None for a switch.
        is_answered: the managed system has taken or refused the attempt.
    """

    kb: KnowledgeBase
    plan: ReconfigurationPlan
    policy: RetryPolicy
    managed: ManagedSystem | None
    component: str
    operation: str
    configuration: Configuration | None = None
    attempt: Attempt | None = None
    is_answered: bool = False
    _count: int = 0
    _due: float = -math.inf
    _operation: Operation | None = None
    _refusal: Exception | None = None

    @property
    def reason(self) -> str:
        """The number of attempts and the result of the last one, in words."""
        assert self.attempt is not None
        tried = {1: "once", 2: "twice"}.get(self._count, f"{self._count} times")
        return f"tried {tried}: {self.attempt.reason}"

    @property
    def is_under_way(self) -> bool:
        """Whether an attempt has not ended."""
        return self.attempt is not None and self.attempt.end is None

    def begin(self, now: float) -> None:
        """Give the command if its pause is over and no attempt is under way."""
        if self.managed is None or self.is_under_way or now < self._due:
            return
        name = None
        parameters = None
        if self.configuration is not None:
            name = self.configuration.name
            parameters = self.configuration.parameters
        self._operation = None
        self._refusal = None
        self.is_answered = False
        self.attempt = self.kb.record_attempt(
            self.plan, self.component, self.operation, name, parameters, self._count + 1
        )
        try:
            self._operation = self._give(self.managed)
        except ProtocolError as mistake:
            self.abandon(str(mistake))
            raise
        except Exception as error:
            self._refusal = error
        self._count += 1
        self.is_answered = True

    def advance(self, now: float) -> str | None:
        """Return "completed" or "failed" once the command has ended, None before."""
        if self.managed is None:
            return "completed"
        while True:
            self.begin(now)
            if self.attempt is None or self.attempt.end is not None:
                return None
            try:
                outcome = self._outcome(self.managed, now - self.attempt.start)
            except ProtocolError as mistake:
                self.abandon(str(mistake))
                raise
            if outcome is None:
                return None
            result, reason = outcome
            self.kb.finish_attempt(self.attempt, result, reason)
            if result == "completed" or self._count >= self.policy.attempts:
                return result
            self._due = now + self.policy.back_off * 2.0 ** min(self._count - 1, 60)

    def abandon(self, reason: str) -> None:
        """Cancel the operation that is under way, if any."""
        if self.attempt is not None and self.attempt.end is None:
            self._cancel()
            self.kb.finish_attempt(self.attempt, "abandoned", reason)

    def _give(self, managed: ManagedSystem) -> Operation | None:
        name = self.component
        if self.configuration is not None:
            answer = managed.set_parameters(name, self.configuration.parameters)
            return operation_of(answer, f"set_parameters({name!r}, ...)", managed)
        switch = managed.activate if self.operation == "activate" else managed.deactivate
        return operation_of(switch(name), f"{self.operation}({name!r})", managed)

    def _outcome(self, managed: ManagedSystem, duration: float) -> tuple[str, str] | None:
        """Return the result of the attempt and its reason, or None while it is under way."""
        has_ended, error = self._progress()
        timeout = self.policy.timeout
        is_late = duration >= timeout
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
            return "failed", f"it was reported done, but {doubt} within {timeout:g} s"
        self._cancel()
        return "failed", f"it was not done within {timeout:g} s"

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
        raise wrong_answer(
            "exception()", operation, error, "what went wrong, as an exception, or None"
        )

    def _cancel(self) -> None:
        """Cancel the operation if it can be cancelled, so that it does not take effect later."""
        try:
            getattr(self._operation, "cancel", lambda: None)()
        except Exception as error:
            _log.warning("an operation could not be cancelled: %s", words_of(error))
