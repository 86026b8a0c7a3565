"""The managed system: what the manager commands, and how its answers are read."""

from contextlib import suppress
from inspect import (
    isasyncgenfunction,
    iscoroutine,
    iscoroutinefunction,
    isgeneratorfunction,
    signature,
)
from typing import Final, Protocol

from kb.elements import ComponentKind, Parameters
from kb.exceptions import ProtocolError, UnknownName
from kb.knowledge_base import KnowledgeBase

_LATE: Final = (iscoroutinefunction, isasyncgenfunction, isgeneratorfunction)


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


def is_active(managed: ManagedSystem, component: str) -> bool | None:
    """Return whether a component runs; None if the managed system does not know."""
    answer = getattr(managed, "is_active", lambda _: None)(component)
    if answer is None or isinstance(answer, bool):
        return answer
    raise wrong_answer(f"is_active({component!r})", managed, answer, "True, False or None")


def look(managed: ManagedSystem, component: str) -> tuple[bool | None, str]:
    """Return what `is_active` returns, and "", or None and the error that it raised, in words."""
    try:
        return is_active(managed, component), ""
    except ProtocolError:
        raise
    except Exception as error:
        return None, words_of(error)


def words_of(error: BaseException) -> str:
    return str(error) or type(error).__name__


def wrong_answer(call: str, stage: object, answer: object, expected: str) -> ProtocolError:
    """Return the error for a value that a protocol does not allow."""
    if iscoroutine(answer):
        answer.close()
    return ProtocolError(
        f"{call} of {type(stage).__name__} returned {answer!r:.80}; it is to return {expected}"
    )


class Looking(Protocol):
    """What a managed system has if it knows which components run."""

    def is_active(self, component: str, /) -> bool | None:
        """Return at once whether a component runs; None if that is not known."""


def check_methods(role: str, stage: object, protocol: type, optional: type | None = None) -> None:
    """Raise `ProtocolError` unless an object has the methods of a protocol.

    Args:
        role: of the object, in words, such as "a planner".
        stage: the object.
        protocol: the class whose public methods the object must have.
        optional: the class whose public methods are checked if the object has them.
    """
    owner = type(stage).__name__
    if isinstance(stage, type):
        name = stage.__name__
        raise ProtocolError(f"{role} is an object; {name} is a class: write {name}(...)")
    functions = dict(vars(protocol))
    for name, function in vars(optional).items() if optional else ():
        if hasattr(stage, name):
            functions[name] = function
    for name, function in functions.items():
        if name.startswith("_"):
            continue
        parameters = list(signature(function).parameters)[1:]
        method = getattr(stage, name, None)
        call = f"{name}({', '.join(parameters)})"
        if not callable(method):
            raise ProtocolError(f"{role} has a method {call}; {stage!r:.80} has none")
        if any(is_late(method) for is_late in _LATE):
            raise ProtocolError(
                f"{call} of {owner} is async or a generator; {role} answers at once"
            )
        with suppress(ValueError):  # a method in C may have no signature
            try:
                signature(method).bind(*parameters)
            except TypeError as error:
                raise ProtocolError(
                    f"{role} is called as {call}; {owner}.{name}: {error}"
                ) from None


class ActivityMonitor:
    """A monitor that asks the managed system which components run, between plans.

    A component that was started by the last command to it, and does not run, has failed. In any
    other case only `component_active` is corrected, since the component may have stopped while
    this program was not running. Failed components are asked about too, because a start may
    succeed after its time-out.
    """

    def __init__(self, managed: ManagedSystem) -> None:
        self._managed = managed
        self._unmanaged: set[str] = set()
        self._expected: dict[str, bool] = {}
        self._revision = -1

    def observe(self, kb: KnowledgeBase) -> None:
        """Record which components run against expectation; see `Monitor`."""
        if kb.pending_plan is not None:
            return
        is_first = self._revision < 0
        revision = kb.revision
        if revision != self._revision:
            self._expected = _expected_activity(kb)
            self._revision = revision
        for name, is_expected in self._expected.items():
            is_running = self._look(name)
            if is_running is None or is_running is is_expected:
                continue
            if is_running:
                kb.component_active(name, True)
                continue
            reason = f"{name} is not running, though nobody has stopped it"
            was_started = _was_started(kb, name)
            kb.component_active(name, False, reason)
            if was_started and not is_first:
                kb.component_failed(name, reason)

    def _look(self, name: str) -> bool | None:
        if name in self._unmanaged:
            return None
        try:
            return is_active(self._managed, name)
        except ProtocolError:
            raise
        except UnknownName:  # another system manages it
            self._unmanaged.add(name)
        except Exception:  # not known at this moment
            return None
        return None


def _expected_activity(kb: KnowledgeBase) -> dict[str, bool]:
    """Return whether each active and each failed component is expected to run, by name."""
    active = {}
    failed = {}
    with kb.reading() as state:
        for name, node in state.network.components.items():
            if node.element.kind is ComponentKind.PLAIN:
                continue
            if node in state.active:
                active[name] = True
            elif node in state.failed:
                failed[name] = False
    return {**active, **failed}


def _was_started(kb: KnowledgeBase, component: str) -> bool:
    """Return whether the last command that switched a component started it."""
    for attempt in reversed(kb.history.attempts):
        if attempt.component == component and attempt.operation != "configure":
            return (attempt.operation, attempt.result) == ("activate", "completed")
    return False
