"""Carrying out a reconfiguration plan on the managed system, a bounded slice at each turn."""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from kb.elements import ComponentKind
from kb.knowledge_base import KnowledgeBase
from kb.managed import ManagedSystem, Operation
from kb.reconfiguration import ReconfigurationPlan

__all__ = ["StagedExecutor"]

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Step:
    """One command to one component: how it is given, and what the knowledge base is told once it is carried out."""

    text: str
    component: str
    command: Callable[[], Operation | None]
    report: Callable[[], None]
    give_up: Callable[[], None] = lambda: None
    attempts: int = 0
    operation: Operation | None = field(default=None)


class StagedExecutor:
    """Carries out plans in three stages: deactivate, set parameters, activate.

    The commands of a stage are given together, and the next stage begins when all have ended, so a component gets its
    parameters before it starts. A command that fails is given again; when it fails for good, its component is
    reported failed, so that the next best design is chosen, and the plan ends as failed after the other components
    got what was meant for them.

    Args:
        managed: what is commanded; plain components are never commanded, only booked.
        attempts: how often a command is given before it counts as failed.
    """

    def __init__(self, managed: ManagedSystem, *, attempts: int = 3) -> None:
        self._managed = managed
        self._attempts = attempts
        self._plan: ReconfigurationPlan | None = None
        self._stages: Iterator[list[_Step]] = iter(())
        self._stage: list[_Step] = []
        self._failed: set[str] = set()

    def execute(self, kb: KnowledgeBase) -> None:
        """Do what can be done of the pending plan without waiting."""
        if self._plan is None:
            self._plan = kb.pending_plan
            if self._plan is None:
                return
            self._stages, self._stage, self._failed = _stages(kb, self._managed, self._plan), [], set()
        while True:
            self._stage = [step for step in self._stage if not self._progress(kb, step)]
            if self._stage:
                return
            following = None if self._plan.end is not None else next(self._stages, None)
            if following is None:
                break
            self._stage = [step for step in following if step.component not in self._failed]
            for step in self._stage:
                self._command(step)
        kb.finish_plan(self._plan, "failed" if self._failed else "completed")
        self._plan = None

    def _command(self, step: _Step) -> None:
        step.attempts += 1
        try:
            step.operation = step.command()
        except Exception as error:
            step.operation = _Refused(error)

    def _progress(self, kb: KnowledgeBase, step: _Step) -> bool:
        """Tell whether a step has ended, one way or the other; one that failed is commanded once more at most."""
        if step.operation is not None:
            ended, error = _outcome(step.operation)
            if not ended:
                return False
            if error is not None and step.attempts < self._attempts:
                self._command(step)
                return False
            if error is not None:
                _log.warning("%s failed %d times: %s", step.text, step.attempts, error)
                self._failed.add(step.component)
                step.give_up()
                kb.component_failed(step.component)
                return True
        step.report()
        return True


def _outcome(operation: Operation) -> tuple[bool, BaseException | None]:
    """Return whether an operation has ended, and with which error; asking may raise, e.g. of a cancelled future."""
    try:
        return (True, operation.exception()) if operation.done() else (False, None)
    except Exception as error:
        return True, error


class _Refused:
    """A command that raised at once, as an operation that has ended."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def done(self) -> bool:
        return True

    def exception(self) -> Exception:
        return self._error


def _stages(kb: KnowledgeBase, managed: ManagedSystem, plan: ReconfigurationPlan) -> Iterator[list[_Step]]:
    """Yield the stages of a plan, each decided when it begins."""
    configured = [kb.configurations[name].component for name in plan.parameters]
    paused = [name for name in configured if kb.components[name].stops_to_configure and kb.components[name].is_active]
    paused = [name for name in paused if name not in plan.deactivate]
    yield [_switch(kb, managed, name, active=False) for name in dict.fromkeys([*plan.deactivate, *paused])]
    started = list(dict.fromkeys([*plan.activate, *paused]))
    running = [name for name in configured if kb.components[name].is_active]
    steps = []
    for name in dict.fromkeys([*running, *started]):
        chosen = kb.components[name].selected_configuration
        if chosen is not None:
            steps.append(_configure(kb, managed, name, chosen))
    yield steps
    yield [_switch(kb, managed, name, active=True) for name in started]


def _switch(kb: KnowledgeBase, managed: ManagedSystem, name: str, *, active: bool) -> _Step:
    def command() -> Operation | None:
        if kb.components[name].kind is ComponentKind.PLAIN:
            return None
        return managed.activate(name) if active else managed.deactivate(name)

    verb = "activate" if active else "deactivate"
    return _Step(f"{verb} {name}", name, command, lambda: kb.component_active(name, active))


def _configure(kb: KnowledgeBase, managed: ManagedSystem, name: str, chosen: str) -> _Step:
    parameters = kb.configurations[chosen].parameters

    def give_up() -> None:
        """Unselect what is not in force, so that it is chosen again when the component has recovered."""
        kb.assert_selected(kb.configurations[chosen], False)

    def command() -> Operation | None:
        return managed.set_parameters(name, parameters)

    return _Step(f"configure {name}", name, command, lambda: kb.component_configured(name, parameters), give_up)
