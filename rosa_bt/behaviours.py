"""Leaves: conditions that ask a knowledge base, and actions that tell it what is being done.

What a running behaviour has asked (its request, its progress) is kept for each knowledge base, because behaviours come
and go: a tree switches between two behaviours of one action, and a plan makes a new behaviour for each step.
"""

import json
import logging
import math
from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final
from weakref import WeakKeyDictionary

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin

from kb import Event, InvalidValue, KnowledgeBase, UnknownName
from kb import Status as ElementStatus
from kb.elements import meant_by
from kb.status import OPERATORS, STATUSES
from kb.views import ActionView, ComponentView, ConfigurationView, DesignView, FunctionView
from rosa_bt.exceptions import in_words

_log = logging.getLogger(__name__)

StatusView = ActionView | FunctionView | ComponentView | DesignView | ConfigurationView
"""The view of an element that has a status and a name."""


def halt(root: Behaviour) -> None:
    """Stop every running behaviour of a subtree, children first; what one raises is its feedback and stops no other.

    Raises:
        BaseException: the last that interrupted this, such as KeyboardInterrupt, when all are stopped.
    """
    running = [one for one in root.iterate() if one.status is Status.RUNNING]
    interrupt: BaseException | None = None
    for behaviour in (*running, *running):  # the second time those of which the stop was interrupted
        try:
            if behaviour.status is Status.RUNNING:
                behaviour.stop(Status.INVALID)
        except Exception as error:
            behaviour.feedback_message = f"in terminate: {in_words(error)}"
        except BaseException as error:
            interrupt = error
            continue
        behaviour.status = Status.INVALID
    for behaviour in running:
        behaviour.status = Status.INVALID
    if interrupt is not None:
        raise interrupt


_SAVE_S: Final = 1.0  # how often where a running action is goes to the store [s]
_RESULTS: Final = {Status.SUCCESS: "completed", Status.FAILURE: "failed", Status.INVALID: "abandoned"}


@dataclass(slots=True)
class _Ledger:
    """What is kept for one knowledge base."""

    holders: dict[str, dict[object, str | None]] = field(default_factory=dict)
    """Which running behaviours hold the request of an action, with what each prefers: when a tree switches between two
    of them, the new one starts before the old one is stopped, and the request has to outlive the switch."""
    progress: dict[tuple[object, str, str], object] = field(default_factory=dict)
    """What interrupted behaviours saved, by mission, action and name of the behaviour; see `_EARLIER`."""
    reasons: dict[str, tuple[int, str]] = field(default_factory=dict)
    """Why an action has its status: the revision of the knowledge base, and the sentence."""


_EARLIER: Final = object()
"""Stands for the mission of a program before this one, whose progress is taken up once."""
_ledgers: WeakKeyDictionary[KnowledgeBase, _Ledger] = WeakKeyDictionary()
_missions: WeakKeyDictionary[Behaviour, object] = WeakKeyDictionary()
"""The mission that a tree is, by its root: what is saved in one is nothing to another."""


def _ledger(kb: KnowledgeBase) -> _Ledger:
    found = _ledgers.get(kb)
    if found is None:
        found = _ledgers.setdefault(kb, _Ledger())
        found.progress |= {(_EARLIER, *key): json.loads(saved) for key, saved in kb.history.progress.items()}
        for action in kb.store.left if kb.store is not None else ():
            if action in kb.actions:
                kb.cancel_action(action, "abandoned", "the program that requested it has ended")
    return found


def begin_mission(root: Behaviour) -> None:
    """Keep what the behaviours of a tree save apart from what those of other trees do."""
    _missions.setdefault(root, object())


def forget_progress(kb: KnowledgeBase) -> None:
    """Drop what interrupted actions saved: the next mission with this knowledge base begins at the beginning."""
    _ledger(kb).progress.clear()
    for key in kb.history.progress:
        _keep(kb, key, "")


def _keep(kb: KnowledgeBase, key: tuple[str, str], saved: str) -> None:
    kb.tell(Event(0, kb.now, "progress", (*key, saved)))


def kept(kb: KnowledgeBase) -> tuple[object, ...]:
    """Return what is kept of behaviours beside the tree, as it is held: who holds requests, and what was saved."""
    found = _ledger(kb)
    for action in kb.actions:
        found.holders.setdefault(action, {})
    return found.holders, found.progress


def why(kb: KnowledgeBase, action: str) -> str:
    """Return why an action has its status, in the values of when a status changed last: cached until one does."""
    reasons = _ledger(kb).reasons
    found = reasons.get(action)
    if found is None or found[0] != kb.revision:
        reasons[action] = found = kb.revision, kb.why(kb.actions[action])
    return found[1]


class ActionRequest:
    """One behaviour's part in the request of an action, from when it is admitted to the first `close`.

    Args:
        timeout: how long to wait until the robot is configured [s], by the clock of the knowledge base; None if the
            behaviour does not wait for that.
    """

    BOOKKEEPING = "_since"

    def __init__(self, kb: KnowledgeBase, timeout: float | None) -> None:
        if timeout is not None and not timeout > 0:
            raise ValueError(f"a time-out is more than 0 s, or math.inf for none; not {timeout!r}")
        self.timeout: Final = timeout
        self._kb = kb
        self._since = math.nan
        self._held: str | None = None
        self._is_ready = False
        self._token = object()
        _ledger(kb)

    def admit(self, owner: Any, *, even_if_unfeasible: bool = False) -> Status:  # noqa: ANN401  # RosaAction, ForAction
        """Return SUCCESS when the owner may do its work, RUNNING while it waits for the robot, FAILURE if it must not.

        The reason is its feedback. An action that cannot be done any more is given up: the owner is stopped.
        """
        if self._held is None:
            objection = self._open(owner.action, owner.preference)
        else:
            objection = "" if even_if_unfeasible else self._objection(self._held)
            if objection:
                owner.stop(Status.INVALID)  # it has not failed, it cannot be done any more
        if objection:
            owner.feedback_message = objection
            return Status.FAILURE
        if self._is_ready:
            return Status.SUCCESS
        status, owner.feedback_message = self._look(str(self._held))
        self._is_ready = status is Status.SUCCESS
        return status

    def _open(self, action: str, preference: str | None) -> str:
        """Request an action, or join those who hold it; return why not. What is requested is held before it is."""
        kb = self._kb
        if not kb.is_feasible(action):
            return why(kb, action)
        self._since, self._held = kb.now, action
        _ledger(kb).holders.setdefault(action, {})[self._token] = preference
        reply = kb.request_action(action, preference)
        if not reply:
            del _ledger(kb).holders[action][self._token]
            self._held = None
        return "" if reply else reply.reason

    def _objection(self, action: str) -> str:
        """Return why an action that is held cannot be done any more; empty if it can."""
        try:
            return "" if self._kb.is_feasible(action) else why(self._kb, action)
        except UnknownName:
            return f"{action} is no longer in the model"

    def _look(self, action: str) -> tuple[Status, str]:
        """Return SUCCESS when the robot is configured, RUNNING before that, FAILURE after the time-out; and why."""
        kb = self._kb
        if self.timeout is None:
            return Status.SUCCESS, ""
        if kb.actions[action].status is not ElementStatus.SOLVED:
            lacking = why(kb, action)
        elif kb.pending_plan is not None:
            lacking = f"the robot is being reconfigured ({kb.pending_plan})"
        else:
            return Status.SUCCESS, ""
        if kb.now - self._since >= self.timeout:
            return Status.FAILURE, f"not ready within {self.timeout:g} s: {lacking}"
        return Status.RUNNING, f"waiting: {lacking}"

    def close(self, status: Status, reason: str) -> None:
        """Let go of the action; the last one who holds it tells the knowledge base how it ended.

        An interrupt leaves it as it is, or not yet closed: closed again, it is closed, and reported once.
        """
        action, kb = self._held, self._kb
        if action is None:
            return
        others = _ledger(kb).holders.setdefault(action, {})
        others.pop(self._token, None)
        if not others and action in kb.actions:  # one that left the model was cancelled with it
            if status is Status.INVALID:
                reason = "" if kb.is_feasible(action) else kb.why(kb.actions[action])
            kb.cancel_action(action, _RESULTS[status], "" if status is Status.SUCCESS else reason)
            for preference in list(others.values()):  # of a thread that has joined meanwhile
                kb.request_action(action, preference)
        self._held, self._is_ready = None, False


class Careful(Behaviour):
    """A behaviour whose exceptions are its FAILURE, with the text as feedback; an interrupt stops it."""

    def advance(self) -> Generator[Behaviour, None, Status]:
        """Do what is done in a tick; yield what is visited before this one, and return the outcome."""
        raise NotImplementedError

    def tick(self) -> Iterator[Behaviour]:
        try:
            try:
                new_status = yield from self.advance()
            except Exception as error:
                self.feedback_message = in_words(error)
                _log.debug("%s failed", self.name, exc_info=True)
                new_status = Status.FAILURE
            if new_status is Status.RUNNING:
                self.status = new_status
            else:
                self.stop(new_status)
        except BaseException:
            self.stop(Status.INVALID)
            raise
        yield self

    def shutdown(self) -> None:
        """Stop if still running; called when the tree is shut down."""
        if self.status is Status.RUNNING:
            self.stop(Status.INVALID)


class KbBehaviour(Careful):
    """A leaf that knows a knowledge base; an exception in it is its FAILURE, with the text as feedback.

    Attributes:
        known: number of the last event that it knew of when it was ticked; None of an action, which takes its time.
    """

    BOOKKEEPING = "known"

    def __init__(self, name: str, kb: KnowledgeBase) -> None:
        super().__init__(name)
        self.kb = kb
        self.known: int | None = None

    def stop(self, new_status: Status) -> None:
        """Terminate the round; an exception in that turns success into failure, an interruption stays one."""
        self.status = self._terminated(new_status)
        self.iterator = self.tick()

    def _terminated(self, new_status: Status) -> Status:
        try:
            self.terminate(new_status)
        except Exception as error:
            self.feedback_message = f"{in_words(error)} (at the end)"
            return Status.FAILURE if new_status is Status.SUCCESS else new_status
        return new_status

    def advance(self) -> Generator[Behaviour, None, Status]:
        yield from ()  # it has no children
        return self._advance()

    def _advance(self) -> Status:
        with self.kb.reading():  # what it is asked belongs to one moment, which a trace can name
            self.known = self.kb.log.last
            if self.status is not Status.RUNNING:
                self.initialise()
            return self._updated()

    def _updated(self) -> Status:
        status = self.update()
        if type(status) is not Status:
            raise TypeError(f"update returned {status!r}, which is no py_trees.common.Status")
        return status

    def _answer(self, objection: str) -> Status:
        """Return what a condition is: FAILURE if something speaks against it, which is the feedback."""
        self.feedback_message = objection
        return Status.FAILURE if objection else Status.SUCCESS


class ActionBehaviour(PortsMixin, KbBehaviour):
    """A behaviour about one ROSA action, named directly or through the port `action`.

    Attributes:
        given: the name with which it was constructed; None where the port carries it.
    """

    INPUT_PORTS = {"action": PortInformation(str, False, "name of the ROSA action")}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it

    def __init_subclass__(cls, *, tag: str | None = None, register: bool = False) -> None:
        """Leave py_trees' process-wide registry of tags alone unless asked: names of classes need not be unique."""
        super().__init_subclass__(tag=tag, register=register)

    def __init__(self, name: str, kb: KnowledgeBase, action: str | None = None) -> None:
        super().__init__(name, kb)
        self.given: Final = action
        if action is not None:
            kb.is_feasible(action)  # an unknown action is found here, not in the middle of a mission

    @property
    def action(self) -> str:
        """Name of the ROSA action: as constructed, or else what the port `action` carries."""
        return str(self.get_input("action") if self.given is None else self.given)


class IsActionFeasible(ActionBehaviour):
    """Condition: SUCCESS while the action's status is not "unfeasible", FAILURE with the reason otherwise.

    Args:
        action: name of the ROSA action; without it, the port `action` gives it.
        during: how long it takes [s]. It has to stay feasible as long, as far as is known: to begin, at the worse ends
            of what is forecast, and once it is requested, as expected, for what is left of its time.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(self, name: str, kb: KnowledgeBase, action: str | None = None, *, during: float = 0.0) -> None:
        super().__init__(name, kb, action)
        self.during, self.ends_too_soon = during, False  # it is feasible now, and will not be for as long

    def update(self) -> Status:
        action, self.ends_too_soon = self.action, False
        if not self.kb.is_feasible(action):
            return self._answer(why(self.kb, action))
        began = [one.start for one in self.kb.required_actions if one.action == action] if self.during else []
        left = self.during - sum(self.kb.now - start for start in began)
        if left <= 0.0:
            return self._answer("")
        until = self.kb.feasible_until(action, left)
        self.ends_too_soon = (until.at if began else until.earliest) is not None
        return self._answer(f"{action} takes {left:.3g} s and is {until}" if self.ends_too_soon else "")


class HasStatus(KbBehaviour):
    """Condition: SUCCESS while an element of the model has a status, FAILURE with the reason otherwise.

    Whether an action can be done is the question of `IsActionFeasible`: one that is being done is not "feasible" but
    "solved".

    Args:
        element: name of an action, function, component, design or configuration, or a view such as
            `kb.components["camera"]` where elements of several kinds share the name.
        status: one that an element of this kind can have, e.g. "failure".

    Raises:
        kb.UnknownName, kb.AmbiguousName, kb.InvalidValue: there is no such element, several, or never that status.
    """

    def __init__(self, name: str, kb: KnowledgeBase, element: str | StatusView, status: str) -> None:
        super().__init__(name, kb)
        if isinstance(element, str):
            tables: dict[str, Mapping[str, StatusView]] = {"action": kb.actions, "function": kb.functions}
            tables |= {"component": kb.components, "function design": kb.designs, "configuration": kb.configurations}
            element = meant_by(element, tables, "element", "pass the view meant, e.g. kb.")
        possible = STATUSES[element.node.kind]
        if status not in possible:
            known = ", ".join(repr(str(one)) for one in possible)
            raise InvalidValue(f"{element.node.kind} {element.name!r} is never {status!r}; it can be {known}")
        self.element, self.wanted = element, status

    def update(self) -> Status:
        status = self.element.status
        return self._answer("" if status == self.wanted else f"{self.element.name} is not {self.wanted} but {status}")


class Measurement(KbBehaviour):
    """Condition: SUCCESS while the latest measurement of an attribute compares as asked, FAILURE otherwise.

    Args:
        attribute: its name.
        operator: one of `>=`, `>`, `<=`, `<`.
        value: what to compare with, in the attribute's unit.
        unknown: what to return while the attribute is not measured, or was too long ago.

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
        unknown: Status = Status.FAILURE,
    ) -> None:
        super().__init__(name, kb)
        if operator not in OPERATORS:
            raise ValueError(f"{operator!r} compares nothing; an operator is one of {', '.join(OPERATORS)}")
        self.attribute, self.operator, self.value = kb.attributes[attribute], operator, float(value)
        self._unknown = unknown

    def update(self) -> Status:
        attribute, measured = self.attribute, self.attribute.value
        if measured is None or attribute.is_stale:
            self.feedback_message = f"{attribute.name} is not measured{'' if measured is None else ' any more'}"
            return self._unknown
        holds = OPERATORS[self.operator](measured, self.value)
        return self._answer("" if holds else f"{attribute.name} {measured:.6g} is not {self.operator} {self.value:.6g}")


class RosaAction(ActionBehaviour):
    """Action: what a mission does while the robot is configured for it; a mission subclasses this.

    A subclass implements `update`, and `initialise` and `terminate` if it needs them, without calling those of its
    base. The action is requested before `initialise` and released after `terminate`, exactly once, however it ends:
    SUCCESS is "completed", FAILURE (or an exception, with its text as feedback) "failed", an interruption or the tree's
    shutdown "abandoned". A refused request is FAILURE with the reason, and the subclass is not called at all. An action
    that becomes unfeasible while it runs is interrupted, "abandoned", and FAILURE with the reason. One that can be
    continued says where it is, in `save_progress`, and goes on from there in `restore_progress`.

    Args:
        action: name of the ROSA action; without it, the port `action` gives it.
        preference: name of the attribute to favour when a configuration is chosen, or None; also a port.
        wait: start working only when the robot is configured for the action; RUNNING with what is lacking before that.
        timeout: how long to wait [s], by the clock of the knowledge base; then FAILURE with what is lacking.
        even_if_unfeasible: go on also when the action becomes unfeasible meanwhile.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    BOOKKEEPING = "_saved_s"
    INPUT_PORTS = ActionBehaviour.INPUT_PORTS | {"preference": PortInformation(str, False, "attribute to favour", "")}

    def __init__(
        self,
        name: str,
        kb: KnowledgeBase,
        action: str | None = None,
        preference: str | None = None,
        *,
        wait: bool = False,
        timeout: float = math.inf,
        even_if_unfeasible: bool = False,
    ) -> None:
        super().__init__(name, kb, action)
        self.wait, self.timeout, self.even_if_unfeasible = wait, timeout, even_if_unfeasible
        self._preference = preference
        self._request = ActionRequest(kb, timeout if wait else None)
        self._has_begun = False
        self._saved_s = -math.inf

    @property
    def preference(self) -> str | None:
        """Name of the attribute to favour: as constructed, or else what the port `preference` carries, if anything."""
        if self._preference is not None:
            return self._preference
        with suppress(RuntimeError):  # this leaf is not connected to a blackboard
            return self.get_input("preference") or None
        return None

    def save_progress(self) -> object | None:
        """Return where the action is, or None (the default) if it starts afresh next time.

        Called before `terminate` when the action is interrupted or has failed, and about once a second while it runs if
        the knowledge base has a store, which keeps what JSON can hold for the program that opens it next. It is kept by
        action and name of the behaviour, apart for each tree that a `TreeRunner` has, until the action succeeds or the
        mission begins anew: a runner takes the tree over or shuts it down, its root succeeds, or `forget_progress(kb)`.
        """
        return None

    def restore_progress(self, progress: object) -> None:
        """Go on from what `save_progress` returned; called after `initialise`, and only if something was saved."""

    def forget_progress(self) -> None:
        """Drop what was saved, of whichever action: the next start is at the beginning."""
        progress, missions = _ledger(self.kb).progress, (self._mission, _EARLIER)
        for key in [key for key in progress if key[0] in missions and key[2] == self.name]:
            del progress[key]
        for kept in [kept for kept in self.kb.history.progress if kept[1] == self.name]:
            _keep(self.kb, kept, "")

    @property
    def is_left(self) -> bool:
        """Whether a program before this one has left progress that is not taken up yet."""
        return any((key[0], key[2]) == (_EARLIER, self.name) for key in _ledger(self.kb).progress)

    def stop(self, new_status: Status) -> None:
        """Save progress, terminate the round and release the request, also when the subclass raises.

        It is stopped only when all that is done: whoever stops it again after an interrupt goes on with what is left.
        """
        ended = Status.INVALID
        try:
            if self._has_begun:
                try:
                    self._save(new_status)
                finally:
                    ended = self._terminated(new_status)
                    self._has_begun = False
            else:
                ended = new_status
        finally:
            self._request.close(ended, self.feedback_message)
        self.status = ended
        self.iterator = self.tick()

    def _advance(self) -> Status:
        status = self._request.admit(self, even_if_unfeasible=self.even_if_unfeasible)
        if status is not Status.SUCCESS:
            return status
        if not self._has_begun:
            self._begin()
        status = self._updated()
        if status is Status.RUNNING and self.kb.store is not None and self.kb.now >= self._saved_s + _SAVE_S:
            self._save(status)
        return status

    def _begin(self) -> None:
        self._has_begun = True
        self.initialise()
        progress, self._saved_s = _ledger(self.kb).progress, self.kb.now
        left = progress.pop((_EARLIER, self.action, self.name), None)
        saved = progress.get((self._mission, self.action, self.name), left)
        if saved is not None:
            self.restore_progress(saved)

    @property
    def _mission(self) -> object:
        root: Behaviour = self
        while root.parent is not None:
            root = root.parent
        return _missions.get(root)

    def _save(self, new_status: Status) -> None:
        saved = _ledger(self.kb).progress
        try:
            key = (self._mission, self.action, self.name)
            progress = None if new_status is Status.SUCCESS else self.save_progress()
            saved.pop(key, None)
            if progress is not None:
                saved[key] = progress
            if self.kb.store is not None:
                self._saved_s = self.kb.now
                _keep(self.kb, key[1:], "" if progress is None else json.dumps(progress))
        except Exception as error:
            self.feedback_message = f"{in_words(error)} (progress is not saved)"
