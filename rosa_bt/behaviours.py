"""Leaves: conditions that ask a knowledge base, and actions that request what they do."""

from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin

from kb import KnowledgeBase
from kb.elements import meant_by, status_of
from kb.status import OPERATORS
from kb.views import ElementView
from rosa_bt.exceptions import report
from rosa_bt.requests import (
    FAILURE,
    INVALID,
    RUNNING,
    SUCCESS,
    ActionRequest,
    requests_of,
    why,
)

Ticking = Generator[Behaviour, None, Status]
"""Yields the nodes that are visited, as `tick` of py_trees does, and returns the outcome."""


def halt(root: Behaviour) -> None:
    """Stop every running behaviour of a subtree, children first; exceptions are reported."""
    for node in [node for node in root.iterate() if node.status is RUNNING]:
        try:
            node.stop(INVALID)
        except Exception as error:
            report(node, error, " (at the end)")
        node.status = INVALID


class _EndedBadly(Exception):
    """A behaviour raised when it was stopped after SUCCESS or FAILURE; that is reported already."""


def guard(behaviour: Behaviour) -> None:
    """Wrap a behaviour, for good: when it raises, it fails, and its children are stopped.

    If it raises while it is interrupted, the interruption goes on.
    """
    if "tick" in vars(behaviour):  # it is wrapped already
        return
    tick = behaviour.tick
    stop = behaviour.stop

    def guarded_tick() -> Iterator[Behaviour]:
        try:
            yield from tick()
        except Exception as error:
            if not isinstance(error, _EndedBadly):
                report(behaviour, error)
                with suppress(_EndedBadly):
                    behaviour.stop(FAILURE)
            for child in behaviour.children:
                halt(child)
            behaviour.status = FAILURE
            yield behaviour

    def guarded_stop(new_status: Status = INVALID) -> None:
        try:
            stop(new_status)
        except Exception as error:
            for child in behaviour.children:
                halt(child)
            report(behaviour, error, " (at the end)")
            behaviour.status = INVALID if new_status is INVALID else FAILURE
            if new_status is not INVALID:
                raise _EndedBadly from error

    vars(behaviour).update(tick=guarded_tick, stop=guarded_stop)


def finish(behaviour: Behaviour, new_status: Status) -> None:
    """Give a behaviour the status of this tick, and stop it if that is an end."""
    if type(new_status) is not Status:
        raise TypeError(f"update returned {new_status!r}, which is no py_trees.common.Status")
    if new_status is RUNNING:
        behaviour.status = new_status
    else:
        behaviour.stop(new_status)


class KbBehaviour(Behaviour):
    """A leaf that uses a knowledge base.

    Attributes:
        last_event: number of the last event before it was ticked; None for an action, which is not
            ticked at one moment.
    """

    def __init__(self, name: str, kb: KnowledgeBase) -> None:
        super().__init__(name)
        self.kb = kb
        self.last_event: int | None = None
        guard(self)

    def tick(self) -> Iterator[Behaviour]:
        with self.kb.reading():  # all is answered at one moment, which the trace can name
            self.last_event = self.kb.log.last
            if self.status is not RUNNING:
                self.initialise()
            new_status = self.update()
        finish(self, new_status)
        yield self

    def _answer(self, objection: str) -> Status:
        """Return SUCCESS if there is no objection, else FAILURE; it becomes the feedback."""
        self.feedback_message = objection
        return FAILURE if objection else SUCCESS


class ActionBehaviour(PortsMixin, KbBehaviour):
    """A behaviour about one ROSA action, whose name is an argument or is read from a port.

    Attributes:
        named_action: the name that the constructor was given; None if the port `action` gives it.
    """

    INPUT_PORTS = {"action": PortInformation(str, False, "name of the ROSA action")}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it

    def __init_subclass__(cls, *, tag: str | None = None, register: bool = False) -> None:
        """Keep the class out of py_trees' registry, unless asked: names there have to be unique."""
        super().__init_subclass__(tag=tag, register=register)

    def __init__(self, name: str, kb: KnowledgeBase, action: str | None = None) -> None:
        super().__init__(name, kb)
        self.named_action = action
        if action is not None:
            kb.is_feasible(action)  # raises now, not during a mission, if it is unknown

    @property
    def action(self) -> str:
        """Name of the ROSA action."""
        if self.named_action is not None:
            return self.named_action
        return str(self.get_input("action"))


class IsActionFeasible(ActionBehaviour):
    """Condition: SUCCESS while the action is not unfeasible, else FAILURE with the reason.

    Args:
        action: name of the ROSA action; without it, the port `action` gives it.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def update(self) -> Status:
        kb = self.kb
        return self._answer("" if kb.is_feasible(self.action) else why(kb, self.action))


class HasStatus(KbBehaviour):
    """Condition: SUCCESS while an element of the model has a status, else FAILURE with the reason.

    To ask whether an action can be done, use `IsActionFeasible`: the status of an action that is
    requested and configured is "solved", not "feasible".

    Args:
        element: name of an action, function, component, design or configuration; or a view such as
            `kb.components["camera"]`, if elements of several kinds have the same name.
        status: a status that elements of this kind can have, e.g. "failure".

    Raises:
        kb.UnknownName, kb.AmbiguousName: no element, or more than one, has this name.
        kb.InvalidValue: an element of this kind never has this status.
    """

    def __init__(
        self, name: str, kb: KnowledgeBase, element: str | ElementView, status: str
    ) -> None:
        super().__init__(name, kb)
        if isinstance(element, str):
            tables: dict[str, Mapping[str, ElementView]] = {
                "action": kb.actions,
                "function": kb.functions,
                "component": kb.components,
                "function design": kb.designs,
                "configuration": kb.configurations,
            }
            element = meant_by(element, tables, "element", "pass the view meant, e.g. kb.")
        self.element = element
        self.wanted = status_of(element.node.kind, status)

    def update(self) -> Status:
        status = self.element.status
        other = f"{self.element.name} is not {self.wanted} but {status}"
        return self._answer("" if status == self.wanted else other)


class Measurement(KbBehaviour):
    """Condition: SUCCESS while the comparison holds for the latest measurement of an attribute.

    Args:
        attribute: its name.
        operator: one of `>=`, `>`, `<=`, `<`.
        value: what to compare with, in the attribute's unit.
        unknown: the status to return while the attribute has no measurement, or only one that is
            too old.

    Raises:
        kb.UnknownName: no such attribute; the message lists the nearest ones.
        ValueError: no such operator.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        attribute: str,
        operator: str,
        value: float,
        *,
        unknown: Status = FAILURE,
    ) -> None:
        super().__init__(name, kb)
        if operator not in OPERATORS:
            raise ValueError(f"{operator!r} is not an operator; use one of {', '.join(OPERATORS)}")
        self.attribute = kb.attributes[attribute]
        self.operator = operator
        self.value = float(value)
        self.unknown = unknown

    def update(self) -> Status:
        name = self.attribute.name
        measured = self.attribute.value
        if measured is None or self.attribute.is_stale:
            when = "yet" if measured is None else "any more"
            self.feedback_message = f"{name} is not measured {when}"
            return self.unknown
        holds = OPERATORS[self.operator](measured, self.value)
        violation = f"{name} {measured:.6g} is not {self.operator} {self.value:.6g}"
        return self._answer("" if holds else violation)


class Requester(Behaviour):
    """A behaviour that requests an action while it runs: `RosaAction` and `ForAction`.

    Attributes:
        exclusive: wait until every interrupted action has halted, and let every other action wait.
        even_if_unfeasible: go on when the action becomes unfeasible while it runs; for a subclass
            to set, not recommended.
        halting_timeout: how long an interrupted action may take to halt [s].
    """

    exclusive: bool = False
    even_if_unfeasible: bool = False
    halting_timeout: float = 10.0
    _rosa_request: ActionRequest

    def tick(self) -> Iterator[Behaviour]:
        try:
            new_status = self._rosa_request.admit()
            if new_status is SUCCESS:
                new_status = yield from self._rosa_work()
            finish(self, new_status)
        except Exception:
            raise  # the guard fails it
        except BaseException:
            self.stop(INVALID)
            raise
        yield self

    def _rosa_work(self) -> Ticking:
        """Do the work of one tick: yield the nodes that are visited before, return the status."""
        raise NotImplementedError

    def shutdown(self) -> None:
        """Stop the behaviour if it is running; called when the tree is shut down."""
        halt(self)

    def halting(self) -> Status:
        """Return RUNNING until the robot has stopped doing the action; anything else ends halting.

        Called after an interruption, once `terminate` has returned, and then once in each tick. The
        action stays requested meanwhile, so its components stay configured. An action that is next
        waits for it if it is exclusive, or shares a component or its name with this one. The
        default ends at once. When `halting_timeout` has passed, the others wait no longer; the log
        says so, and so does the result of the request, with `feedback_message`.
        """
        return SUCCESS

    @property
    def halts_at_once(self) -> bool:
        """Whether `halting` is not overridden."""
        return getattr(self.halting, "__func__", None) is Requester.halting


class RosaAction(Requester, ActionBehaviour):
    """Action: base class of what a mission does while the robot is configured for it.

    Override `update`, and `initialise` and `terminate` if needed; they need not call the base's.
    The action is requested before `initialise` and released once, after `terminate`. The result of
    the request follows from how the behaviour ends: SUCCESS is "completed", FAILURE or an exception
    is "failed", an interruption or the shutdown of the tree is "abandoned". If the request is
    refused, the behaviour fails with the reason, and nothing of the subclass is called. If the
    action becomes unfeasible while it runs, it is "abandoned", and the behaviour fails with the
    reason.

    An action that can go on where it was also overrides `save_progress` and `restore_progress`; one
    that needs time to stop overrides `halting`.

    Args:
        action: name of the ROSA action; without it, the port `action` gives it.
        preference: name of the attribute to favour when a configuration is chosen, or None.
        wait: begin only when the robot is configured for the action; RUNNING until then.
        exclusive: begin only when every interrupted action has halted, and let the others wait.
        halting_timeout: how long the others wait until this has halted [s].

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str | None = None,
        preference: str | None = None,
        *,
        wait: bool = False,
        exclusive: bool = False,
        halting_timeout: float = Requester.halting_timeout,
    ) -> None:
        super().__init__(name, kb, action)
        self.wait = wait
        self.exclusive = exclusive
        self.halting_timeout = halting_timeout
        self.preference = preference
        self._rosa_request = ActionRequest(self, kb)
        self._rosa_has_begun = False

    @property
    def is_halting(self) -> bool:
        """Whether it was interrupted, and `halting` is not over yet."""
        return self._rosa_request.is_halting

    def save_progress(self) -> object | None:
        """Return how far the action has come, or None (the default) if it starts afresh next time.

        Called before `terminate` when the action is interrupted or fails. It is kept by action and
        name of the behaviour until the action succeeds or a new mission begins.
        """
        return None

    def restore_progress(self, progress: object) -> None:
        """Continue from what `save_progress` returned; called after `initialise`."""

    def _rosa_work(self) -> Ticking:
        yield from ()  # it has no children
        if not self._rosa_has_begun:
            self._rosa_has_begun = True
            self.initialise()
            progress = requests_of(self.kb).progress.get((self.action, self.name))
            if progress is not None:
                self.restore_progress(progress)
        return self.update()

    def stop(self, new_status: Status) -> None:
        """Save progress, call `terminate`, and release the request or begin to halt.

        The status changes last: after an interrupt in here, a second call does the rest.
        """
        has_begun = self._rosa_has_begun
        ended = INVALID
        try:
            if has_begun:
                try:
                    progress = None if new_status is SUCCESS else self.save_progress()
                    all_progress = requests_of(self.kb).progress
                    all_progress.pop((self.action, self.name), None)
                    if progress is not None:
                        all_progress[self.action, self.name] = progress
                finally:
                    self.terminate(new_status)
            ended = new_status
            self._rosa_has_begun = False
        except Exception as error:
            report(self, error, " (at the end)")
            ended = FAILURE if new_status is SUCCESS else new_status
            self._rosa_has_begun = False
        finally:
            if ended is INVALID and has_begun:
                self._rosa_request.halt()
            elif not self.is_halting:
                self._rosa_request.close(ended, self.feedback_message)
            elif self.status is RUNNING:  # an interrupt cut the first stop short
                self._rosa_request.advance_halting()
        self.status = ended
        self.iterator = self.tick()
