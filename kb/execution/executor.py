"""Carrying out a reconfiguration plan on the managed system, a bounded slice at each turn."""

import logging
from collections.abc import Iterable, Iterator, Mapping

from kb.elements import Component, ComponentKind, Configuration
from kb.exceptions import InvalidValue, UnknownName
from kb.execution.attempts import Command, RetryPolicy
from kb.execution.safeguards import Budgets, Quarantine, Quarantined
from kb.inference.network import Node
from kb.inference.state import State
from kb.knowledge_base import KnowledgeBase
from kb.managed_system import ManagedSystem, is_active
from kb.reconfiguration import ReconfigurationPlan
from kb.status import Status

__all__ = ["StagedExecutor"]

_log = logging.getLogger(__name__)


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all have ended, so a component gets its
    parameters before it starts. A command that fails, or takes too long, is given again later; so is one that was
    said to be done when the managed system can tell that it is not. When it fails for good, the plan ends as failed
    after the other components got what was meant for them, and the next best is chosen: a configuration whose
    parameters cannot be set is put in quarantine, a component that cannot be switched is reported failed. What the plan
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
        self._policy = RetryPolicy(attempts, timeout, back_off)
        self._of_kind = {
            _kind(kind): RetryPolicy(attempts, lasts, back_off) for kind, lasts in (timeout_by_kind or {}).items()
        }
        self._of_component = {
            name: RetryPolicy(attempts, lasts, back_off) for name, lasts in (timeout_by_component or {}).items()
        }
        self._unchecked = sorted(self._of_component)
        self._quarantine = Quarantine(hold)
        self._budgets = Budgets(budgets)
        self._known: KnowledgeBase | None = None
        self._plan: ReconfigurationPlan | None = None
        self._stages: Iterator[list[Command]] = iter(())
        self._stage: list[Command] = []
        self._failed: set[str] = set()
        self._commanded: set[str] = set()

    @property
    def quarantined(self) -> tuple[Quarantined, ...]:
        """The configurations that count as unfeasible now because they could not be set."""
        return tuple(self._quarantine.held.values())

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting.

        Raises:
            UnknownName: a time-out was given for a component, or a budget for an attribute, that the model does not
                have; at the first turn only.
        """
        if kb is not self._known:
            self._check_names(kb)
            self._quarantine.adopt(kb)
            self._known = kb
        now = kb.now
        self._quarantine.review(kb)
        if self._plan is None:
            self._plan = kb.pending_plan
            if self._plan is None:
                return
            self._stages, self._stage = self._staged(kb, self._plan), []
            self._failed, self._commanded = set(), set()
        if self._stage:
            self._drop_removed(kb)
        while True:
            self._stage = [command for command in self._stage if not self._has_ended(kb, command, now)]
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

    def _check_names(self, kb: KnowledgeBase) -> None:
        components, self._unchecked = self._unchecked, []
        for name in components:
            if name not in kb.components:
                raise UnknownName("component", name, kb.components)
        for name in self._budgets.most:
            if name not in kb.attributes:
                raise UnknownName("attribute", name, kb.attributes)

    def _drop_removed(self, kb: KnowledgeBase) -> None:
        """Abandon commands to what is no longer in the model, or with what is not."""
        kept = []
        for command in self._stage:
            is_there = command.configuration is None or command.configuration in kb.configurations
            if is_there and command.component in kb.components:
                kept.append(command)
            else:
                command.abandon("it is no longer in the model")
        self._stage = kept

    def _has_ended(self, kb: KnowledgeBase, command: Command, now: float) -> bool:
        """Go on with a command and tell whether it has ended, one way or the other; the knowledge base is told how."""
        result = command.advance(now)
        if result is None:
            return False
        if result == "failed":
            self._give_up(kb, command)
        elif command.parameters is not None:
            kb.component_configured(command.component, command.parameters)
        else:
            kb.component_active(command.component, command.operation == "activate")
        return True

    def _give_up(self, kb: KnowledgeBase, command: Command) -> None:
        _log.warning("%s %s failed, %s", command.operation, command.component, command.reason)
        self._failed.add(command.component)
        if command.configuration is None:
            active = self._look(command.component)
            if active is not None:
                kb.component_active(command.component, active)
            kb.component_failed(command.component, f"it could not be {command.operation}d, {command.reason}")
        else:
            reason = f"its parameters could not be set, {command.reason}"
            self._quarantine.put(kb, command.configuration, reason)

    def _hold(self, kb: KnowledgeBase, component: str) -> None:
        """Do without the parameters of a component that runs, because something else has failed."""
        self._failed.add(component)
        chosen = kb.components[component].selected_configuration
        if chosen is not None:
            self._quarantine.put(kb, chosen, "with its parameters a budget might be exceeded")

    def _look(self, component: str) -> bool | None:
        """Return whether a component is active, None if nobody can tell."""
        try:
            return is_active(self._managed, component)
        except Exception:
            return None

    def _staged(self, kb: KnowledgeBase, plan: ReconfigurationPlan) -> Iterator[list[Command]]:
        """Yield the stages of a plan, each decided when it begins."""
        with kb.reading() as state:
            activated, deactivated, parameters = _steps(state, plan, kb.open_plans)
            configured = _configured(state, parameters)
            running = [one for one in configured if state.active[one.index] and one.name not in deactivated]
            paused = [one.name for one in running if _component(one).stops_to_configure]
        yield self._switches(kb, plan, [*deactivated, *paused], active=False)
        started = [*activated, *paused]
        with kb.reading() as state:
            reconfigured = [one.name for one in _configured(state, parameters) if state.active[one.index]]
        if self._budgets.most:
            for name in reconfigured:  # those that use less of a budget than before come first in a plan
                if self._budgets.allow(kb, started, self._failed) or self._budgets.are_eased(kb, name, self._failed):
                    yield self._settings(kb, plan, [name])
                else:
                    self._hold(kb, name)
            if not self._budgets.allow(kb, started, self._failed):
                self._failed.update(started)
            reconfigured = []
        yield self._settings(kb, plan, [*reconfigured, *started])
        starting = self._switches(kb, plan, started, active=True)
        self._commanded = {command.component for command in starting if command.managed is not None}
        yield starting
        if self._failed:
            yield self._rolled_back(kb, plan, started)

    def _switches(
        self, kb: KnowledgeBase, plan: ReconfigurationPlan, names: Iterable[str], *, active: bool, anyway: bool = False
    ) -> list[Command]:
        """Return the commands that switch components; those that have failed are left out, but not if `anyway`."""
        operation, commands = "activate" if active else "deactivate", []
        with kb.reading() as state:
            for component in _known(state, names):
                name, is_plain = component.name, _component(component).kind is ComponentKind.PLAIN
                if anyway or name not in self._failed:
                    managed = None if is_plain else self._managed
                    commands.append(Command(kb, plan, self._policy_of(component), managed, name, operation))
        return commands

    def _settings(self, kb: KnowledgeBase, plan: ReconfigurationPlan, names: Iterable[str]) -> list[Command]:
        """Return the commands that give components the parameters of their selected configurations."""
        commands = []
        with kb.reading() as state:
            for component in _known(state, names):
                chosen = next((one for one in component.parts if state.selected[one.index]), None)
                if chosen is not None and component.name not in self._failed:
                    assert isinstance(chosen.element, Configuration)
                    name, policy, values = component.name, self._policy_of(component), chosen.element.parameters
                    commands.append(Command(kb, plan, policy, self._managed, name, "configure", chosen.name, values))
        return commands

    def _rolled_back(self, kb: KnowledgeBase, plan: ReconfigurationPlan, started: list[str]) -> list[Command]:
        """Undo what was begun for functions that cannot be had: else it would run on, and be started at each plan."""
        unsure = [name for name in started if name in self._failed & self._commanded and self._look(name) is not False]
        with kb.reading() as state:
            users = [user for component in _known(state, started) for user in component.wholes]
            in_vain = [design for design in dict.fromkeys(users) if _is_in_vain(state, design)]
            in_vain.sort(key=lambda design: design.index)
        for design in in_vain:
            kb.assert_selected(design.element, False)
        with kb.reading() as state:
            active = [component for component in _known(state, started) if state.active[component.index]]
            idle = [component.name for component in active if not state.users[component.index]]
        return self._switches(kb, plan, [*unsure, *idle], active=False, anyway=True)

    def _policy_of(self, component: Node) -> RetryPolicy:
        of_kind = self._of_kind.get(_component(component).kind, self._policy)
        return self._of_component.get(component.name, of_kind)


def _steps(
    state: State, plan: ReconfigurationPlan, open_plans: Iterable[ReconfigurationPlan]
) -> tuple[list[str], list[str], list[str]]:
    """Return what to activate, deactivate and configure: the plan's own, and what older open plans still have to do.

    Those are abandoned when this one completes, so what of them is still wanted is done with it.
    """
    activated, deactivated, parameters = list(plan.activate), list(plan.deactivate), list(plan.parameters)
    for older in open_plans:
        if older is plan:
            continue
        for component in _known(state, [*older.activate, *older.deactivate]):
            if state.required[component.index] != state.active[component.index]:
                (deactivated if state.active[component.index] else activated).append(component.name)
        known = state.network.configurations
        parameters += [name for name in older.parameters if name in known and state.selected[known[name].index]]
    return activated, deactivated, parameters


def _known(state: State, names: Iterable[str]) -> list[Node]:
    """Return the components of these names that are in the model, each once."""
    components = state.network.components
    return [components[name] for name in dict.fromkeys(names) if name in components]


def _configured(state: State, configurations: Iterable[str]) -> list[Node]:
    """Return the components of configurations that are in the model, each once."""
    known = state.network.configurations
    return list(dict.fromkeys(known[name].wholes[0] for name in configurations if name in known))


def _is_in_vain(state: State, design: Node) -> bool:
    """Tell whether a design is selected for a function that cannot be had."""
    return state.selected[design.index] and state.status[design.wholes[0].index] is Status.UNFEASIBLE


def _component(node: Node) -> Component:
    assert isinstance(node.element, Component)
    return node.element


def _kind(kind: str) -> ComponentKind:
    try:
        return ComponentKind(kind)
    except ValueError:
        known = ", ".join(ComponentKind)
        raise InvalidValue(f"{kind!r} is no kind of component to give a time-out to; kinds are {known}") from None
