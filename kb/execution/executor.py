"""Carrying out a reconfiguration plan on the managed system, a bounded slice at each turn."""

import logging
from collections.abc import Iterator, Mapping

from kb.elements import ComponentKind
from kb.exceptions import InvalidValue, UnknownName
from kb.execution.attempts import Command, Patience, Step
from kb.execution.budgets import Budgets
from kb.execution.condemned import Condemnation, Condemned
from kb.knowledge_base import KnowledgeBase
from kb.managed import ManagedSystem, Operation
from kb.managed import is_active as told_active
from kb.reconfiguration import ReconfigurationPlan
from kb.status import Status

__all__ = ["StagedExecutor"]

_log = logging.getLogger(__name__)


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all have ended, so a component gets its
    parameters before it starts. A command that fails, or takes too long, is given again later; so is one that was
    said to be done when the managed system can tell that it is not. When it fails for good, the plan ends as failed
    after the other components got what was meant for them, and the next best is chosen: parameters that cannot be set
    rule out their configuration for a while, a component that cannot be switched is reported failed. What the plan
    started for a function that cannot be had any more is stopped again.

    Args:
        managed: what is commanded; plain components are never switched, only booked.
        attempts: how often a command is given before it counts as failed.
        timeout: how long an attempt may take, in the time of the knowledge base's clock [s].
        timeout_by_kind: the same for all components of a kind.
        timeout_by_component: the same for single components; goes before that of their kind.
        back_off: how long after a failure the command is given again [s]; twice as long after each further one.
        hold: how long a configuration that could not be set counts as unfeasible [s].
        budgets: the most that all that is chosen and runs may be estimated to use, by name of attribute, also on the
            way: what runs gets its parameters one after the other, and a plan that might exceed one, because something
            failed, is not carried out further.
    """

    def __init__(
        self,
        managed: ManagedSystem,
        *,
        attempts: int = 3,
        timeout: float = 60.0,
        timeout_by_kind: Mapping[str, float] | None = None,
        timeout_by_component: Mapping[str, float] | None = None,
        back_off: float = 0.5,
        hold: float = 300.0,
        budgets: Mapping[str, float] | None = None,
    ) -> None:
        self._managed = managed
        self._patience = Patience(attempts, timeout, back_off)
        self._of_kind = {
            _kind(kind): Patience(attempts, lasts, back_off) for kind, lasts in (timeout_by_kind or {}).items()
        }
        self._of_component = {
            name: Patience(attempts, lasts, back_off) for name, lasts in (timeout_by_component or {}).items()
        }
        self._unchecked = set(self._of_component)
        self._condemned = Condemned(hold)
        self._budgets = Budgets(budgets)
        self._known: KnowledgeBase | None = None
        self._plan: ReconfigurationPlan | None = None
        self._stages: Iterator[list[Step]] = iter(())
        self._stage: list[Step] = []
        self._failed: set[str] = set()
        self._commanded: set[str] = set()

    @property
    def condemnations(self) -> tuple[Condemnation, ...]:
        """The configurations that could not be set, in order; those without an end count as unfeasible now."""
        return self._condemned.records

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting.

        Raises:
            UnknownName: a time-out was given for a component, or a budget for an attribute, that the model does not
                have; at the first turn only.
        """
        if kb is not self._known:
            self._meet(kb)
        now = kb.now
        self._condemned.review(kb, now)
        if self._plan is None:
            self._plan = kb.pending_plan
            if self._plan is None:
                return
            self._stages, self._stage = self._staged(kb, self._plan), []
            self._failed, self._commanded = set(), set()
        while True:
            self._stage = [step for step in self._stage if not self._has_ended(kb, step, now)]
            if self._stage:
                return
            following = None if self._plan.end is not None else next(self._stages, None)
            if following is None:
                break
            self._stage = following
            for step in self._stage:
                step.begin(now)
        kb.finish_plan(self._plan, "failed" if self._failed else "completed")
        self._plan = None

    def _meet(self, kb: KnowledgeBase) -> None:
        self._check_names(kb)
        self._budgets.check_names(kb)
        self._condemned.adopt(kb)
        self._known = kb

    def _check_names(self, kb: KnowledgeBase) -> None:
        unchecked, self._unchecked = self._unchecked, set()
        for name in sorted(unchecked):
            if name not in kb.components:
                raise UnknownName("component", name, kb.components)

    def _has_ended(self, kb: KnowledgeBase, step: Step, now: float) -> bool:
        """Go on with a step and tell whether it has ended, one way or the other; the knowledge base is told how."""
        if step.is_void:
            step.abandon("it is no longer in the model")
            return True
        result = step.advance(now)
        if result is None:
            return False
        command = step.command
        if result == "failed":
            self._give_up(kb, step, now)
        elif command.operation == "configure":
            kb.component_configured(command.component, command.parameters)
        else:
            kb.component_active(command.component, command.operation == "activate")
        return True

    def _give_up(self, kb: KnowledgeBase, step: Step, now: float) -> None:
        command = step.command
        _log.warning("%s %s failed, %s", command.operation, command.component, step.reason)
        self._failed.add(command.component)
        if command.configuration is None:
            is_active = self._look(command.component)
            if is_active is not None:
                kb.component_active(command.component, is_active)
            kb.component_failed(command.component, f"it could not be {command.operation}d, {step.reason}")
        else:
            reason = f"its parameters could not be set, {step.reason}"
            self._condemned.condemn(kb, command.configuration, reason, now)

    def _hold(self, kb: KnowledgeBase, component: str) -> None:
        """Do without the parameters of a component that runs, because something else has failed."""
        self._failed.add(component)
        chosen = kb.components[component].selected_configuration
        if chosen is not None:
            self._condemned.condemn(kb, chosen, "with its parameters a budget might be exceeded", kb.now)

    def _look(self, component: str) -> bool | None:
        """Return whether a component is active, None if nobody can tell."""
        try:
            return told_active(self._managed, component)
        except Exception:
            return None

    def _staged(self, kb: KnowledgeBase, plan: ReconfigurationPlan) -> Iterator[list[Step]]:
        """Yield the stages of a plan, each decided when it begins."""
        activated, deactivated, parameters = _steps(kb, plan)
        configured = [kb.configurations[name].component for name in parameters if name in kb.configurations]
        paused = [name for name in configured if kb.components[name].stops_to_configure]
        paused = [name for name in paused if kb.components[name].is_active and name not in deactivated]
        yield self._switched(kb, plan, [*deactivated, *paused], active=False)
        started = list(dict.fromkeys([*activated, *paused]))
        running = [name for name in configured if name in kb.components and kb.components[name].is_active]
        if self._budgets:
            for name in running:  # those that use less of a budget than before come first in a plan
                if self._budgets.allow(kb, started, self._failed) or self._budgets.are_eased(kb, name, self._failed):
                    yield self._configured(kb, plan, [name])
                else:
                    self._hold(kb, name)
            if not self._budgets.allow(kb, started, self._failed):
                self._failed.update(started)
            running = []
        yield self._configured(kb, plan, [*running, *started])
        starting = self._switched(kb, plan, started, active=True)
        self._commanded = {step.command.component for step in starting if step.command.give is not None}
        yield starting
        if self._failed:
            yield self._rolled_back(kb, plan, started)

    def _switched(self, kb: KnowledgeBase, plan: ReconfigurationPlan, names: list[str], *, active: bool) -> list[Step]:
        return [
            self._step(kb, plan, _switch(kb, self._managed, name, active=active))
            for name in dict.fromkeys(names)
            if name in kb.components and name not in self._failed
        ]

    def _configured(self, kb: KnowledgeBase, plan: ReconfigurationPlan, names: list[str]) -> list[Step]:
        known = [name for name in dict.fromkeys(names) if name in kb.components and name not in self._failed]
        chosen = {name: kb.components[name].selected_configuration for name in known}
        return [
            self._step(kb, plan, _configure(kb, self._managed, name, configuration))
            for name, configuration in chosen.items()
            if configuration is not None
        ]

    def _rolled_back(self, kb: KnowledgeBase, plan: ReconfigurationPlan, started: list[str]) -> list[Step]:
        """Undo what was begun for functions that cannot be had: else it would run on, and be started at each plan."""
        names = [name for name in started if name in kb.components]
        unsure = [name for name in names if name in self._failed & self._commanded and self._look(name) is not False]
        for design in kb.designs.values():
            is_in_vain = kb.functions[design.function].status is Status.UNFEASIBLE and design.is_selected
            if is_in_vain and not set(names).isdisjoint(design.components):
                kb.assert_selected(design, False)
        needed = {part for design in kb.designs.values() if design.is_selected for part in design.components}
        idle = [name for name in names if kb.components[name].is_active and name not in needed]
        return [
            self._step(kb, plan, _switch(kb, self._managed, name, active=False))
            for name in dict.fromkeys([*unsure, *idle])
        ]

    def _step(self, kb: KnowledgeBase, plan: ReconfigurationPlan, command: Command) -> Step:
        of_kind = self._of_kind.get(kb.components[command.component].kind, self._patience)
        return Step(kb, plan, command, self._of_component.get(command.component, of_kind))


def _steps(kb: KnowledgeBase, plan: ReconfigurationPlan) -> tuple[list[str], list[str], list[str]]:
    """Return what to activate, deactivate and configure: the plan's own, and what older open plans still have to do.

    Those are abandoned when this one completes, so what of them is still wanted is done with it.
    """
    activated, deactivated, parameters = list(plan.activate), list(plan.deactivate), list(plan.parameters)
    for older in kb.open_plans:
        if older is plan:
            continue
        switched = [kb.components[name] for name in (*older.activate, *older.deactivate) if name in kb.components]
        activated += [one.name for one in switched if one.is_required and not one.is_active]
        deactivated += [one.name for one in switched if not one.is_required and one.is_active]
        chosen = [kb.configurations[name] for name in older.parameters if name in kb.configurations]
        parameters += [one.name for one in chosen if one.is_selected]
    return activated, deactivated, parameters


def _kind(kind: str) -> ComponentKind:
    try:
        return ComponentKind(kind)
    except ValueError:
        known = ", ".join(ComponentKind)
        raise InvalidValue(f"{kind!r} is no kind of component to give a time-out to; kinds are {known}") from None


def _switch(kb: KnowledgeBase, managed: ManagedSystem, name: str, *, active: bool) -> Command:
    operation = "activate" if active else "deactivate"
    if kb.components[name].kind is ComponentKind.PLAIN:
        return Command(name, operation, None)

    def is_reached() -> bool | None:
        answer = told_active(managed, name)
        return None if answer is None else answer is active

    return Command(name, operation, lambda: getattr(managed, operation)(name), is_reached)


def _configure(kb: KnowledgeBase, managed: ManagedSystem, name: str, chosen: str) -> Command:
    parameters = kb.configurations[chosen].parameters

    def give() -> Operation | None:
        return managed.set_parameters(name, parameters)

    return Command(name, "configure", give, configuration=chosen, parameters=parameters)
