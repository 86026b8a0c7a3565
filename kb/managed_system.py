"""The managed system: what the manager commands, and how its answers are read."""

from inspect import signature
from typing import Protocol

from kb.elements import ComponentKind, Parameters
from kb.exceptions import ProtocolError
from kb.knowledge_base import KnowledgeBase
from kb.state import in_order


class Operation(Protocol):
    """A command that takes time; a `concurrent.futures.Future` is one."""

    def done(self) -> bool:
        """Return at once whether it has ended."""

    def exception(self) -> BaseException | None:
        """Return the error, or None; called only after it has ended."""


class ManagedSystem(Protocol):
    """The robot's components, which can be commanded to start, to stop and to take parameters.

    Each call returns at once: None if the command is done, an operation if it takes time. A
    command that cannot be done raises, or its operation has an exception.

    A system that knows whether a component runs has a method `is_active(component)` too, which
    returns at once True, False, or None if it does not know. A switch then counts as done only
    when that agrees, and a component that stops by itself is noticed. An operation may have a
    method `cancel()`, which is called when it takes too long or is no longer needed.
    """

    def activate(self, component: str, /) -> Operation | None:
        """Start a component; its parameters were set before."""

    def deactivate(self, component: str, /) -> Operation | None:
        """Stop a component."""

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        """Set the parameters of a component; a stopped one keeps them until it is activated."""


def look(managed: ManagedSystem, component: str) -> tuple[bool | None, str]:
    """Return whether a component runs, and "".

    Return None if the managed system does not know, and its error in words if it raised one.
    """
    try:
        answer = getattr(managed, "is_active", lambda _: None)(component)
    except Exception as error:
        return None, words_of(error)
    if answer is None or isinstance(answer, bool):
        return answer, ""
    raise wrong_answer(f"is_active({component!r})", managed, answer, "True, False or None")


def words_of(error: BaseException) -> str:
    return str(error) or type(error).__name__


def wrong_answer(call: str, stage: object, answer: object, expected: str) -> ProtocolError:
    """Return the error for a value that a protocol does not allow."""
    return ProtocolError(
        f"{call} of {type(stage).__name__} returned {answer!r:.80}; it is to return {expected}"
    )


def check_methods(role: str, stage: object, protocol: type) -> None:
    """Raise `ProtocolError` unless an object has the methods of a protocol.

    Args:
        role: of the object, in words, such as "a planner".
        stage: the object.
        protocol: the class whose public methods the object must have.
    """
    for name, function in vars(protocol).items():
        if name.startswith("_"):
            continue
        parameters = list(signature(function).parameters)[1:]
        method = getattr(stage, name, None)
        call = f"{name}({', '.join(parameters)})"
        if not callable(method):
            raise ProtocolError(f"{role} has a method {call}; {stage!r:.80} has none")
        try:
            signature(method).bind(*parameters)
        except TypeError as error:
            raise ProtocolError(f"{role} is called as {call}; {stage!r:.80}: {error}") from None


class ActivityMonitor:
    """A monitor that asks the managed system which components run, between plans.

    A component that was started by the last command to it, and does not run, has failed. In any
    other case only `component_active` is corrected, since the component may have stopped while
    this program was not running. Failed components are asked about too, because a start may
    succeed after its time-out.
    """

    def __init__(self, managed: ManagedSystem) -> None:
        self._managed = managed
        self._is_first = True

    def observe(self, kb: KnowledgeBase) -> None:
        """Record which components run against expectation; see `Monitor`."""
        if kb.pending_plan is not None:
            return
        with kb.reading() as state:
            nodes = [*in_order(state.active), *in_order(state.failed - state.active)]
            is_expected = {
                node.name: node in state.active
                for node in nodes
                if node.element.kind is not ComponentKind.PLAIN
            }
        for name in is_expected:
            is_running, _ = look(self._managed, name)
            if is_running in (None, is_expected[name]):
                continue
            if is_running:
                kb.component_active(name, True)
                continue
            reason = f"{name} is not running, though nobody has stopped it"
            was_started = _was_started(kb, name)
            kb.component_active(name, False, reason)
            if was_started and not self._is_first:
                kb.component_failed(name, reason)
        self._is_first = False


def _was_started(kb: KnowledgeBase, component: str) -> bool:
    """Return whether the last command that switched a component started it."""
    for attempt in reversed(kb.history.attempts):
        if attempt.component == component and attempt.operation != "configure":
            return (attempt.operation, attempt.result) == ("activate", "completed")
    return False
