"""The managed system: what the manager commands, how its answers are read, and a look at what runs."""

from contextlib import suppress
from inspect import isasyncgenfunction, iscoroutine, iscoroutinefunction, isgeneratorfunction, signature
from typing import Protocol

from kb.elements import ComponentKind, Parameters
from kb.exceptions import ProtocolError, UnknownName
from kb.knowledge_base import KnowledgeBase


class Operation(Protocol):
    """Something under way; a `concurrent.futures.Future` is one."""

    def done(self) -> bool:
        """Tell, at once, whether it has ended."""

    def exception(self) -> BaseException | None:
        """Return what went wrong, or None; asked only after it has ended."""


class ManagedSystem(Protocol):
    """What can be commanded to switch components and set their parameters.

    Each call returns at once: None if it is done already, an operation if it takes time. What cannot be done raises,
    now or as the operation's exception.

    A system that can tell whether a component is running has a method `is_active(component)` too, which returns at once
    True, False, or None where it cannot tell; what is said to be done is then believed only when that agrees, and what
    has stopped by itself is noticed. An operation may have a method `cancel()`, which is called when nobody waits for
    it any longer.
    """

    def activate(self, component: str, /) -> Operation | None:
        """Make a component run; its parameters were set before."""

    def deactivate(self, component: str, /) -> Operation | None:
        """Make a component stop."""

    def set_parameters(self, component: str, parameters: Parameters, /) -> Operation | None:
        """Give a component its parameters; a stopped one keeps them for when it is activated."""


def is_active(managed: ManagedSystem, component: str) -> bool | None:
    """Return what a managed system says of a component, None if it cannot tell."""
    answer = getattr(managed, "is_active", lambda _: None)(component)
    if answer is None or isinstance(answer, bool):
        return answer
    raise wrong_answer(f"is_active({component!r})", managed, answer, "True, False or None")


def look(managed: ManagedSystem, component: str) -> tuple[bool | None, str]:
    """Return what `is_active` does at this moment, and what went wrong with that, in words; empty if nothing did."""
    try:
        return is_active(managed, component), ""
    except ProtocolError:
        raise
    except Exception as error:
        return None, words_of(error)


def words_of(error: BaseException) -> str:
    return str(error) or type(error).__name__


def operation_of(answer: object, call: str, managed: ManagedSystem) -> Operation | None:
    """Return what a command was answered with if it can be followed."""
    if answer is None or (callable(getattr(answer, "done", None)) and callable(getattr(answer, "exception", None))):
        return answer  # type: ignore[return-value]  # it was looked at
    raise wrong_answer(call, managed, answer, "None if it is done, or an operation with done() and exception()")


def wrong_answer(call: str, given: object, answer: object, expected: str) -> ProtocolError:
    """Return the error for an answer that means nothing; a coroutine is closed, for nobody awaits it."""
    if iscoroutine(answer):
        answer.close()
    return ProtocolError(f"{call} of {type(given).__name__} returned {answer!r:.80}; it is to return {expected}")


def check_methods(what: str, given: object, protocol: type, optional: tuple[str, ...] = ()) -> None:
    """Raise `ProtocolError` unless an object has the methods of a protocol, to be called as the protocol has them.

    Args:
        what: what it is given as, in words.
        given: the object.
        protocol: whose public functions it has to have.
        optional: calls of methods that it may have besides, such as "choose(kb)".
    """
    if isinstance(given, type):
        raise ProtocolError(f"{what} is an object; {given.__name__} is a class: write {given.__name__}(...)")
    wanted = {name: list(signature(one).parameters)[1:] for name, one in vars(protocol).items() if name[0] != "_"}
    extra = {call.partition("(")[0]: call.partition("(")[2].rstrip(")").split(", ") for call in optional}
    for name, arguments in (wanted | {name: one for name, one in extra.items() if hasattr(given, name)}).items():
        method, call = getattr(given, name, None), f"{name}({', '.join(arguments)})"
        if not callable(method):
            raise ProtocolError(f"{what} has a method {call}; {given!r:.80} has none")
        if any(is_late(method) for is_late in (iscoroutinefunction, isasyncgenfunction, isgeneratorfunction)):
            raise ProtocolError(f"{call} of {type(given).__name__} is async or a generator; {what} answers at once")
        with suppress(ValueError):  # one that was not written in Python may not say how it is called
            try:
                signature(method).bind(*arguments)
            except TypeError as error:
                raise ProtocolError(f"{what} is called as {call}; {type(given).__name__}.{name}: {error}") from None


class ActivityMonitor:
    """A monitor that asks after each component that is believed to be active, while no plan is being carried out.

    One that was started by the last command to it, and is not running, has failed. Any other belief that is wrong is
    only put right: a component may have been stopped while the program was not there to see it. What has failed is
    asked after too: a start that nobody waited for any longer may have come true.
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
                    one for one in state.network.components.values() if one.element.kind is not ComponentKind.PLAIN
                ]
                active = [(one.name, True) for one in nodes if state.active[one.index]]
                failed = [one for one in nodes if state.failed[one.index] and not state.active[one.index]]
            self._believed = [*active, *((one.name, False) for one in failed)]
            self._believed_at = kb.revision
        for name in [name for name, active in self._believed if active and self._is(name, False)]:
            reason = f"{name} is not running, though nobody has stopped it"
            was_started = _was_started(kb, name)
            kb.component_active(name, False, reason)
            if was_started and not is_first:
                kb.component_failed(name, reason)
        for name in [name for name, active in self._believed if not active and self._is(name, True)]:
            kb.component_active(name, True)

    def _is(self, name: str, active: bool) -> bool:
        try:
            return name not in self._unmanaged and is_active(self._managed, name) is active
        except ProtocolError:
            raise
        except UnknownName:  # it is not this system that manages it
            self._unmanaged.add(name)
        except Exception:
            return False  # nobody can tell at this moment
        return False


def _was_started(kb: KnowledgeBase, component: str) -> bool:
    """Tell whether the last command that switched a component has started it."""
    switches = (one for one in reversed(kb.history.attempts) if one.component == component)
    last = next((one for one in switches if one.operation != "configure"), None)
    return last is not None and (last.operation, last.result) == ("activate", "completed")
