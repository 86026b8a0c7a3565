"""Carries out reconfiguration plans on the managed system; each turn does what it can without waiting."""

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
    """How many attempts a command has, how long each may take [s], and the pause after the first failure [s]."""

    attempts: int
    timeout: float
    back_off: float


class Budgets:
    """The most that what is selected and active may use by estimation, by name of attribute, also during a plan."""

    def __init__(self, most: Mapping[str, float] | None) -> None:
        if not isinstance(most, Mapping | None):
            raise InvalidValue(
                f"budgets are given as the most by name of attribute, not as {most!r}"
            )
        self.most = {name: finite_number(limit) for name, limit in (most or {}).items()}

    def allow(self, kb: KnowledgeBase, started: Collection[str], failed: Collection[str]) -> bool:
        """Return whether the budgets hold once the selection is carried out.

        Then the components `started` are active too, and those that `failed` keep their old parameters.
        """
        loads = self._loads(kb, started, failed)
        return all(
            load <= Decimal(repr(limit))
            for load, limit in zip(loads, self.most.values(), strict=True)
        )

    def are_eased(self, kb: KnowledgeBase, component: str, failed: Collection[str]) -> bool:
        """Return whether an active component uses no more with its new parameters than with its present ones."""
        after, before = self._loads(kb, (), failed), self._loads(kb, (), {*failed, component})
        return all(new <= old for new, old in zip(after, before, strict=True))

    def _loads(
        self, kb: KnowledgeBase, started: Collection[str], failed: Collection[str]
    ) -> list[Decimal]:
        loads = dict.fromkeys(self.most, Decimal())
        with kb.reading() as state:
            for estimation in state.network.model.estimations:
                causer = state.network.find(estimation.causer)
                if estimation.attribute in loads and _counts(kb, state, causer, started, failed):
                    loads[estimation.attribute] += Decimal(repr(estimation.adds))
        return list(loads.values())


def _counts(
    kb: KnowledgeBase, state: State, causer: Node, started: Collection[str], failed: Collection[str]
) -> bool:
    """Return whether an estimation counts: its design is selected, or its component is active and so configured."""
    if causer.kind == "function design":
        return state.selected[causer.index]
    component = causer if causer.kind == "component" else causer.wholes[0]
    if component.name not in started and not state.active[component.index]:
        return False
    if causer is component:
        return True
    if component.name in failed or not any(state.selected[one.index] for one in component.parts):
        return dict(kb.components[component.name].parameters_in_force) == dict(
            causer.element.parameters
        )
    return state.selected[causer.index]


class Quarantine:
    """Configurations that failed; an asserted status makes each of them unfeasible until a hold [s] is over.

    Attributes:
        held: configurations in quarantine and the component of each, by name; up to date after `review`.
    """

    def __init__(self, hold: float) -> None:
        if not is_number(hold) or not hold >= 0:
            raise InvalidValue(f"a hold is 0 s or longer, math.inf for ever, not {hold!r}")
        self._hold = hold
        self.held: dict[str, str] = {}
        self._failed: set[str] = set()

    def put(self, kb: KnowledgeBase, configuration: str, reason: str) -> None:
        """Assert that a configuration is unfeasible, and unselect it, because it is not in force."""
        view = kb.configurations[configuration]
        kb.assert_selected(view, False)
        with suppress(InvalidValue):  # the hold is over already
            kb.assert_status(view, Status.UNFEASIBLE, reason, kb.now + self._hold)
        self.held[configuration] = view.component

    def adopt(self, kb: KnowledgeBase) -> None:
        """Find what was in quarantine when the knowledge base was last closed."""
        last = {
            one.configuration: one for one in kb.history.attempts if one.configuration is not None
        }
        self.held |= {name: one.component for name, one in last.items() if one.result == "failed"}
        self.review(kb)

    def review(self, kb: KnowledgeBase) -> None:
        """Release the configurations whose component has recovered; forget those that are asserted no longer."""
        with kb.reading() as state:
            components, known, asserted = (
                state.network.components,
                state.network.configurations,
                state.asserted,
            )
            stand = {
                name
                for name in self.held
                if name in known and asserted[known[name].index] is Status.UNFEASIBLE
            }
            self.held = {name: one for name, one in self.held.items() if name in stand}
            failed = {
                one
                for one in self.held.values()
                if state.status[components[one].index] is Status.FAILURE
            }
        for name in [name for name, one in self.held.items() if one in self._failed - failed]:
            kb.retract_status(kb.configurations[name])
            del self.held[name]
        self._failed = failed


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all of them have ended. So a component
    gets its parameters before it starts. A command that fails or takes too long is repeated later; so is one that is
    reported done although the managed system says that it is not. When the last attempt fails, the commands to other
    components are still carried out, and the plan ends as failed. A configuration whose parameters cannot be set goes
    into quarantine, a component that cannot be switched is reported failed; so the planner chooses the next best. The
    executor stops again what the plan started for a function that has become unfeasible.

    After an interrupt, such as Ctrl-C within a call, the next turn records commands without a known answer as
    abandoned, and begins the plan's stages again; a command may then be given a second time.

    Args:
        managed: what is commanded; a plain component is not switched, only recorded as active or not.
        attempts: how many attempts a command has before it counts as failed.
        timeout: how long an attempt may take, in the time of the knowledge base's clock [s].
        timeout_by_component: the same for single components, by name [s].
        back_off: the pause after a failed attempt [s]; it doubles after each further failure.
        hold: how long a configuration that could not be set counts as unfeasible [s].
        budgets: the most that what is selected and active may use by estimation, by name of attribute, also during a
            plan: active components get their parameters one after the other, and the rest of a plan is not carried out
            if it might exceed a budget because something failed.
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
        self._managed = managed
        by_name = timeout_by_component or {}
        whole("the number of attempts", attempts)
        for lasts in (timeout, *by_name.values()):
            if not is_number(lasts) or not lasts > 0:
                raise InvalidValue(f"a time-out is more than 0 s, math.inf for none, not {lasts!r}")
        if not is_number(back_off) or not 0 <= back_off < math.inf:
            raise InvalidValue(f"a back-off is a finite number of seconds from 0, not {back_off!r}")
        self._policy = RetryPolicy(attempts, timeout, back_off)
        self._of_component = {
            name: RetryPolicy(attempts, lasts, back_off) for name, lasts in by_name.items()
        }
        self._quarantine = Quarantine(hold)
        self._budgets = Budgets(budgets)
        self._known: KnowledgeBase | None = None
        self._plan: ReconfigurationPlan | None = None
        self._stages: Iterator[list[_Command]] = iter(())
        self._stage: list[_Command] = []
        self._failed: set[str] = set()
        self._paused: list[str] = []
        self._is_under_way = False

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting.

        Raises:
            UnknownName: a time-out was given for a component, or a budget for an attribute, that the model does not
                have; at the first turn only.
            ProtocolError: a method of the managed system or of an operation returned a value that the protocol does
                not allow; the command is abandoned, and given again at the next turn.
        """
        if self._is_under_way and self._plan is not None:
            self._begin_again(kb)
        self._is_under_way = True
        self._go_on(kb)
        self._is_under_way = False

    def _begin_again(self, kb: KnowledgeBase) -> None:
        """Abandon the attempts without a known answer after an interrupt, and begin the stages of the plan again."""
        known = [command.attempt for command in self._stage if command.is_answered]
        for attempt in kb.history.attempts:
            if attempt.end is None and attempt not in known and self._plan in (attempt.plan, None):
                kb.finish_attempt(
                    attempt, "abandoned", "it was interrupted before its answer was known"
                )
        self._stages = (
            self._staged(kb, kb.history.open_plans)
            if self._plan in kb.history.open_plans
            else iter(())
        )

    def _go_on(self, kb: KnowledgeBase) -> None:
        if kb is not self._known:
            self._quarantine.adopt(kb)
            self._known = kb
            for name in self._of_component:
                kb.components[name]
            for name in self._budgets.most:
                kb.attributes[name]
        if self._quarantine.held:
            self._quarantine.review(kb)
        if self._plan is None:
            open_plans = kb.history.open_plans
            if not open_plans:
                return
            self._stages, self._stage = self._staged(kb, open_plans), []
            self._failed, self._paused = set(), []
            self._plan = open_plans[-1]
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
            for command in self._stage:
                command.begin(now)
        kb.finish_plan(self._plan, "failed" if self._failed else "completed")
        self._plan = None

    def _drop_removed(self, kb: KnowledgeBase) -> None:
        """Abandon the commands whose component or configuration is no longer in the model."""
        for command in tuple(self._stage):
            known = command.configuration is None or command.configuration.name in kb.configurations
            if not known or command.component not in kb.components:
                command.abandon("it is no longer in the model")
                self._stage.remove(command)

    def _has_ended(self, kb: KnowledgeBase, command: "_Command", now: float) -> bool:
        """Advance a command and return whether it has ended; if so, tell the knowledge base the result."""
        result = command.advance(now)
        if result is None:
            return False
        if result == "failed":
            self._give_up(kb, command)
        elif command.configuration is None:
            kb.component_active(command.component, command.operation == "activate")
        return True

    def _give_up(self, kb: KnowledgeBase, command: "_Command") -> None:
        _log.warning("%s %s failed, %s", command.operation, command.component, command.reason)
        self._failed.add(command.component)
        if command.configuration is None:
            active, _ = look(self._managed, command.component)
            if active is not None:
                kb.component_active(command.component, active)
            kb.component_failed(
                command.component, f"it could not be {command.operation}d, {command.reason}"
            )
        else:
            reason = f"its parameters could not be set, {command.reason}"
            self._quarantine.put(kb, command.configuration.name, reason)

    def _staged(
        self, kb: KnowledgeBase, open_plans: Sequence[ReconfigurationPlan]
    ) -> Iterator[list["_Command"]]:
        """Yield the stages of the latest open plan; the commands of each are decided when it begins."""
        plan = open_plans[-1]
        with kb.reading() as state:
            activated, deactivated, parameters = _steps(state, open_plans)
            stops = [
                name
                for name, one in _running(state, parameters).items()
                if one.element.stops_to_configure
            ]
        self._paused += [name for name in stops if name not in (*deactivated, *self._paused)]
        started, stopped = [*activated, *self._paused], [*deactivated, *self._paused]
        if stopped:
            yield self._commands(kb, plan, "deactivate", stopped)
        if self._budgets.most:
            yield from self._configured_within_budgets(kb, plan, parameters, started)
            parameters = []
        yield self._commands(kb, plan, "configure", started, parameters)
        if started:
            yield self._commands(kb, plan, "activate", started)
        if self._failed:
            yield self._rolled_back(kb, plan, started)

    def _configured_within_budgets(
        self,
        kb: KnowledgeBase,
        plan: ReconfigurationPlan,
        parameters: Sequence[str],
        started: Sequence[str],
    ) -> Iterator[list["_Command"]]:
        """Configure active components one after the other, first those that use no more of a budget than before.

        A component that might exceed a budget, because another one has failed, is neither configured nor started.
        """
        with kb.reading() as state:
            running = _running(state, parameters)
        eased = [name for name in running if self._budgets.are_eased(kb, name, self._failed)]
        for name in (*eased, *(one for one in running if one not in eased)):
            if name in eased or self._budgets.allow(kb, started, self._failed):
                yield self._commands(kb, plan, "configure", [name])
                continue
            self._failed.add(name)
            chosen = kb.components[name].selected_configuration
            if chosen is not None:
                self._quarantine.put(kb, chosen, "with its parameters a budget might be exceeded")
        if not self._budgets.allow(kb, started, self._failed):
            self._failed.update(started)

    def _commands(
        self,
        kb: KnowledgeBase,
        plan: ReconfigurationPlan,
        operation: str,
        names: Iterable[str],
        configurations: Iterable[str] = (),
    ) -> list["_Command"]:
        """Return commands to components and to active ones of configurations; a failed one is only deactivated."""
        with kb.reading() as state:
            known = _known(state, [*_running(state, configurations), *names])
            chosen = [
                part for one in known.values() for part in one.parts if state.selected[part.index]
            ]
        selected = (
            {part.wholes[0].name: part.element for part in chosen}
            if operation == "configure"
            else {}
        )
        commands = []
        for name, component in known.items():
            if operation != "deactivate" and (
                name in self._failed or (operation == "configure" and name not in selected)
            ):
                continue
            is_booked = operation != "configure" and component.element.kind is ComponentKind.PLAIN
            policy, managed = (
                self._of_component.get(name, self._policy),
                None if is_booked else self._managed,
            )
            commands.append(
                _Command(kb, plan, policy, managed, name, operation, selected.get(name))
            )
        return commands

    def _rolled_back(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, started: list[str]
    ) -> list["_Command"]:
        """Stop and unselect what was started for functions that are unfeasible now: each plan would start it again."""
        given = [
            one for one in kb.history.attempts if one.plan is plan and one.operation == "activate"
        ]
        commanded = self._failed.intersection(one.component for one in given)
        unsure = [
            name
            for name in started
            if name in commanded and look(self._managed, name)[0] is not False
        ]
        with kb.reading() as state:
            users = {
                design
                for component in _known(state, started).values()
                for design in component.wholes
            }
            selected = [design for design in users if state.selected[design.index]]
            in_vain = [
                one for one in selected if state.status[one.wholes[0].index] is Status.UNFEASIBLE
            ]
        for design in sorted(in_vain, key=lambda design: design.index):
            kb.assert_selected(design.element, False)
        with kb.reading() as state:
            known = _known(state, started).items()
            idle = [
                name
                for name, one in known
                if state.active[one.index] and not state.users[one.index]
            ]
        return self._commands(kb, plan, "deactivate", [*unsure, *idle])


@dataclass(slots=True, eq=False)
class _Command:
    """A command to one component: repeated until it is done or has failed for good; each attempt is recorded."""

    kb: KnowledgeBase
    plan: ReconfigurationPlan
    policy: RetryPolicy
    managed: ManagedSystem | None  # None for a plain component: nothing is commanded
    component: str
    operation: str  # activate, deactivate or configure
    configuration: Configuration | None  # None for a switch
    attempt: Attempt | None = None
    is_answered: bool = False  # the managed system has taken or refused the attempt
    _count: int = 0
    _due: float = -math.inf
    _under_way: Operation | None = None
    _refusal: Exception | None = None

    @property
    def reason(self) -> str:
        """The number of attempts and the result of the last one, in words."""
        assert self.attempt is not None
        tried = {1: "once", 2: "twice"}.get(self._count, f"{self._count} times")
        return f"tried {tried}: {self.attempt.reason}"

    def begin(self, now: float) -> None:
        """Give the command if its pause is over and no attempt is under way."""
        if (
            self.managed is None
            or now < self._due
            or (self.attempt is not None and self.attempt.end is None)
        ):
            return
        chosen, number = self.configuration, self._count + 1
        name, values = (None, None) if chosen is None else (chosen.name, chosen.parameters)
        self._under_way = self._refusal = None
        self.is_answered = False
        self.attempt = self.kb.record_attempt(
            self.plan, self.component, self.operation, name, values, number
        )
        try:
            self._under_way = self._given(self.managed)
        except ProtocolError as slip:
            self.abandon(str(slip))
            raise
        except Exception as error:
            self._refusal = error
        self._count, self.is_answered = number, True

    def _given(self, managed: ManagedSystem) -> Operation | None:
        if self.configuration is not None:
            answer = managed.set_parameters(self.component, self.configuration.parameters)
            return operation_of(answer, f"set_parameters({self.component!r}, ...)", managed)
        switch = managed.activate if self.operation == "activate" else managed.deactivate
        return operation_of(
            switch(self.component), f"{self.operation}({self.component!r})", managed
        )

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
            except ProtocolError as slip:
                self.abandon(str(slip))
                raise
            if outcome is None:
                return None
            result, reason = outcome
            self.kb.finish_attempt(self.attempt, result, reason)
            if result == "completed" or self._count >= self.policy.attempts:
                return result
            self._due = now + self.policy.back_off * 2.0 ** min(self._count - 1, 60)

    def abandon(self, reason: str) -> None:
        if self.attempt is not None and self.attempt.end is None:
            self._cancel()
            self.kb.finish_attempt(self.attempt, "abandoned", reason)

    def _outcome(self, managed: ManagedSystem, lasts: float) -> tuple[str, str] | None:
        """Return the result of the attempt and its reason, or None while it is under way."""
        ended, error = self._progress()
        is_late = lasts >= self.policy.timeout
        if error is not None:
            return "failed", words_of(error)
        if not ended and not is_late:
            return None
        is_reached, doubt = None, f"{self.component} was not in that state"
        if self.configuration is None:  # whether parameters are in force cannot be asked
            active, trouble = look(managed, self.component)
            is_reached = None if active is None else active is (self.operation == "activate")
            if trouble:
                is_reached, doubt = False, f"its state could not be read ({trouble})"
        if ended and is_reached is not False:
            return "completed", ""
        if not is_late:
            return None
        if is_reached:
            return "completed", "it was never reported done, but it is"
        if ended:
            return "failed", f"it was reported done, but {doubt} within {self.policy.timeout:g} s"
        self._cancel()
        return "failed", f"it was not done within {self.policy.timeout:g} s"

    def _progress(self) -> tuple[bool, BaseException | None]:
        """Return whether the operation has ended, and its error; a cancelled future raises when it is asked."""
        operation = self._under_way
        try:
            if operation is None:
                return True, self._refusal
            ended = operation.done()
            error = operation.exception() if ended is True else None
        except Exception as error:
            return True, error
        if not isinstance(ended, bool):
            raise wrong_answer("done()", operation, ended, "True or False")
        if error is None or isinstance(error, BaseException):
            return ended, error
        raise wrong_answer(
            "exception()", operation, error, "what went wrong, as an exception, or None"
        )

    def _cancel(self) -> None:
        """Cancel the operation if it can be cancelled, so that it does not take effect later."""
        try:
            getattr(self._under_way, "cancel", lambda: None)()
        except Exception as error:
            _log.warning("an operation could not be cancelled: %s", words_of(error))


def _steps(
    state: State, open_plans: Sequence[ReconfigurationPlan]
) -> tuple[Sequence[str], Sequence[str], Sequence[str]]:
    """Return what to activate, to deactivate and to configure: the latest plan's steps, and what older plans left open.

    The older plans are abandoned when the latest completes, so it also does their steps that are still needed.
    """
    plan, known = open_plans[-1], state.network.configurations
    activated, deactivated, parameters = (
        list(plan.activate),
        list(plan.deactivate),
        list(plan.parameters),
    )
    for older in open_plans[:-1]:
        for name, component in _known(state, [*older.activate, *older.deactivate]).items():
            if state.required[component.index] != state.active[component.index]:
                (deactivated if state.active[component.index] else activated).append(name)
        parameters += [
            name for name in older.parameters if name in known and state.selected[known[name].index]
        ]
    return activated, deactivated, parameters


def _known(state: State, names: Iterable[str]) -> dict[str, Node]:
    components = state.network.components
    return {name: components[name] for name in names if name in components}


def _running(state: State, configurations: Iterable[str]) -> dict[str, Node]:
    """Return the components of configurations that are in the model and active."""
    known = state.network.configurations
    components = [known[name].wholes[0] for name in configurations if name in known]
    return {one.name: one for one in components if state.active[one.index]}
