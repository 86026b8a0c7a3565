"""The managed system: what the manager commands, how its answers are read, and a look at what runs."""

from contextlib import suppress
from inspect import (
    isasyncgenfunction,
    iscoroutine,
    iscoroutinefunction,
    isgeneratorfunction,
    signature,
)
from typing import Protocol

from kb.elements import ComponentKind, Parameters
from kb.exceptions import ProtocolError, UnknownName
from kb.knowledge_base import KnowledgeBase


class Operation(Protocol):
    """A command that takes time; a `concurrent.futures.Future` is one."""

    def done(self) -> bool:
        """Return at once whether it has ended."""

    def exception(self) -> BaseException | None:
        """Return the error, or None; called only after it has ended."""


class ManagedSystem(Protocol):
    """The robot's components, which can be commanded to start, to stop and to take parameters.

    Each call returns at once: None if the command is done, an operation if it takes time. A command that cannot be
    done raises, or its operation has an exception.

    A system that knows whether a component runs has a method `is_active(component)` too, which returns at once True,
    False, or None if it does not know. A switch then counts as done only when that agrees, and a component that stops
    by itself is noticed. An operation may have a method `cancel()`, which is called when it takes too long or is no
    longer needed.
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


def operation_of(answer: object, call: str, managed: ManagedSystem) -> Operation | None:
    """Return the answer to a command if it is None or an operation; else raise `ProtocolError`."""
    if answer is None or (
        callable(getattr(answer, "done", None)) and callable(getattr(answer, "exception", None))
    ):
        return answer  # type: ignore[return-value]  # checked by the condition
    raise wrong_answer(
        call, managed, answer, "None if it is done, or an operation with done() and exception()"
    )


def wrong_answer(call: str, given: object, answer: object, expected: str) -> ProtocolError:
    """Return the error for a value that a protocol does not allow; a coroutine is closed, as nobody awaits it."""
    if iscoroutine(answer):
        answer.close()
    return ProtocolError(
        f"{call} of {type(given).__name__} returned {answer!r:.80}; it is to return {expected}"
    )


def check_methods(what: str, given: object, protocol: type, optional: tuple[str, ...] = ()) -> None:
    """Raise `ProtocolError` unless an object has the methods of a protocol, with the same arguments.

    Args:
        what: the role of the object, in words, such as "a planner".
        given: the object.
        protocol: the class whose public methods the object must have.
        optional: calls of further methods that are checked if the object has them, such as "choose(kb)".
    """
    if isinstance(given, type):
        raise ProtocolError(
            f"{what} is an object; {given.__name__} is a class: write {given.__name__}(...)"
        )
    wanted = {
        name: list(signature(one).parameters)[1:]
        for name, one in vars(protocol).items()
        if name[0] != "_"
    }
    extra = {
        call.partition("(")[0]: call.partition("(")[2].rstrip(")").split(", ") for call in optional
    }
    for name, arguments in (
        wanted | {name: one for name, one in extra.items() if hasattr(given, name)}
    ).items():
        method, call = getattr(given, name, None), f"{name}({', '.join(arguments)})"
        if not callable(method):
            raise ProtocolError(f"{what} has a method {call}; {given!r:.80} has none")
        if any(
            is_late(method)
            for is_late in (iscoroutinefunction, isasyncgenfunction, isgeneratorfunction)
        ):
            raise ProtocolError(
                f"{call} of {type(given).__name__} is async or a generator; {what} answers at once"
            )
        with suppress(ValueError):  # a method in C may have no signature
            try:
                signature(method).bind(*arguments)
            except TypeError as error:
                raise ProtocolError(
                    f"{what} is called as {call}; {type(given).__name__}.{name}: {error}"
                ) from None


class ActivityMonitor:
    """A monitor that asks the managed system whether components run as the knowledge base has it, between plans.

    A component that was started by the last command to it, and does not run, has failed. In any other case only
    `component_active` is corrected, since the component may have stopped while this program was not running. Failed
    components are asked about too, because a start may succeed after its time-out.
    """

    def __init__(self, managed: ManagedSystem) -> None:
        self._managed = managed
        self._unmanaged: set[str] = set()
        self._believed: list[tuple[str, bool]] = []
        self._believed_at = -1

    def observe(self, kb: KnowledgeBase) -> None:
        if kb.pending_plan is not None:
            return
        is_first = self._believed_at < 0
        if kb.revision != self._believed_at:
            with kb.reading() as state:
                nodes = [
                    one
                    for one in state.network.components.values()
                    if one.element.kind is not ComponentKind.PLAIN
                ]
                active = [(one.name, True) for one in nodes if state.active[one.index]]
                failed = [
                    one for one in nodes if state.failed[one.index] and not state.active[one.index]
                ]
            self._believed = [*active, *((one.name, False) for one in failed)]
            self._believed_at = kb.revision
        for name in [name for name, active in self._believed if active and self._is(name, False)]:
            reason = f"{name} is not running, though nobody has stopped it"
            was_started = _was_started(kb, name)
            kb.component_active(name, False, reason)
            if was_started and not is_first:
                kb.component_failed(name, reason)
        for name in [
            name for name, active in self._believed if not active and self._is(name, True)
        ]:
            kb.component_active(name, True)

    def _is(self, name: str, active: bool) -> bool:
        try:
            return name not in self._unmanaged and is_active(self._managed, name) is active
        except ProtocolError:
            raise
        except UnknownName:  # another system manages it
            self._unmanaged.add(name)
        except Exception:
            return False  # not known at this moment
        return False


def _was_started(kb: KnowledgeBase, component: str) -> bool:
    """Return whether the last command that switched a component started it."""
    switches = (one for one in reversed(kb.history.attempts) if one.component == component)
    last = next((one for one in switches if one.operation != "configure"), None)
    return last is not None and (last.operation, last.result) == ("activate", "completed")
