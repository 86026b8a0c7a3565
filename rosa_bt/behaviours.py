"""Leaves: conditions that ask a knowledge base, and actions that request what they do.

Requests and progress are kept per knowledge base and not in the behaviours, because behaviours come and go: a tree
switches between two behaviours that do the same action, and a plan makes a new behaviour for each step.
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
"""A view of an element that has a name and a status."""


def halt(root: Behaviour) -> None:
    """Stop every running behaviour of a subtree, children first; an exception becomes the feedback of its behaviour.

    Raises:
        BaseException: the last interrupt that arrived meanwhile, e.g. KeyboardInterrupt, after all are stopped.
    """
    running = [one for one in root.iterate() if one.status is Status.RUNNING]
    interrupt: BaseException | None = None
    for behaviour in (
        *running,
        *running,
    ):  # the second round stops those whose stop was interrupted
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


_SAVE_S: Final = 1.0  # interval at which the progress of a running action goes to the store [s]
_RESULTS: Final = {
    Status.SUCCESS: "completed",
    Status.FAILURE: "failed",
    Status.INVALID: "abandoned",
}


@dataclass(slots=True)
class _Ledger:
    """The requests and the progress of behaviours, for one knowledge base."""

    holders: dict[str, dict[object, str | None]] = field(default_factory=dict)
    """For each action, the running behaviours that hold its request, with their preferences. When a tree switches
    between two of them, the new one starts before the old one is stopped, and the request has to stay open."""
    progress: dict[tuple[object, str, str], object] = field(default_factory=dict)
    """What interrupted behaviours saved, by mission (or `_EARLIER`), action and name of the behaviour."""
    reasons: dict[str, tuple[int, str]] = field(default_factory=dict)
    """Why an action has its status: the revision of the knowledge base for which this holds, and the sentence."""


_EARLIER: Final = object()
"""The key, in place of a mission, of progress that an earlier program left in the store; it is restored once."""
_ledgers: WeakKeyDictionary[KnowledgeBase, _Ledger] = WeakKeyDictionary()
_missions: WeakKeyDictionary[Behaviour, object] = WeakKeyDictionary()
"""The mission of each tree, by its root: progress that is saved in one mission is not restored in another."""


def _ledger(kb: KnowledgeBase) -> _Ledger:
    found = _ledgers.get(kb)
    if found is None:
        found = _ledgers.setdefault(kb, _Ledger())
        found.progress |= {
            (_EARLIER, *key): json.loads(saved) for key, saved in kb.history.progress.items()
        }
        for action in kb.store.left if kb.store is not None else ():
            if action in kb.actions:
                kb.cancel_action(action, "abandoned", "the program that requested it has ended")
    return found


def begin_mission(root: Behaviour) -> None:
    """Keep the progress that is saved in this tree apart from that of other trees."""
    _missions.setdefault(root, object())


def forget_progress(kb: KnowledgeBase) -> None:
    """Drop the progress that interrupted actions saved: the next mission with this knowledge base starts afresh."""
    _ledger(kb).progress.clear()
    for key in kb.history.progress:
        _keep(kb, key, "")


def _keep(kb: KnowledgeBase, key: tuple[str, str], saved: str) -> None:
    kb.tell(Event(0, kb.now, "progress", (*key, saved)))


def kept(kb: KnowledgeBase) -> tuple[object, ...]:
    """Return what is kept outside the tree, itself and no copy: the holders of requests, and the saved progress."""
    found = _ledger(kb)
    for action in kb.actions:
        found.holders.setdefault(action, {})
    return found.holders, found.progress


def why(kb: KnowledgeBase, action: str) -> str:
    """Return why an action has its status; the sentence is cached, with its values, until any status changes."""
    reasons = _ledger(kb).reasons
    found = reasons.get(action)
    if found is None or found[0] != kb.revision:
        reasons[action] = found = kb.revision, kb.why(kb.actions[action])
    return found[1]


class ActionRequest:
    """The share of one behaviour in the request of an action, from `admit` to the first `close`.

    Args:
        timeout: how long to wait for the robot's configuration [s], by the clock of the knowledge base; None: no wait.
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
        """Return SUCCESS if the owner may work, RUNNING while it waits for the robot, FAILURE if it must not work.

        The reason becomes the owner's feedback. If the action has become unfeasible, the owner is stopped.
        """
        if self._held is None:
            objection = self._open(owner.action, owner.preference)
        else:
            objection = "" if even_if_unfeasible else self._objection(self._held)
            if objection:
                owner.stop(Status.INVALID)  # interrupted, not failed: the action is unfeasible
        if objection:
            owner.feedback_message = objection
            return Status.FAILURE
        if self._is_ready:
            return Status.SUCCESS
        status, owner.feedback_message = self._look(str(self._held))
        self._is_ready = status is Status.SUCCESS
        return status

    def _open(self, action: str, preference: str | None) -> str:
        """Request an action, or join its holders; return why it is refused. It is held before it is requested."""
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
        """Return why a held action cannot go on; empty if it can."""
        try:
            return "" if self._kb.is_feasible(action) else why(self._kb, action)
        except UnknownName:
            return f"{action} is no longer in the model"

    def _look(self, action: str) -> tuple[Status, str]:
        """Return SUCCESS if the robot is configured, RUNNING while it is not, FAILURE after the time-out; and why."""
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
        """Let go of the action; the last holder cancels the request, with its result.

        After an interrupt in here, a second call finishes the work; the result is reported once.
        """
        action, kb = self._held, self._kb
        if action is None:
            return
        others = _ledger(kb).holders.setdefault(action, {})
        others.pop(self._token, None)
        if (
            not others and action in kb.actions
        ):  # removing an action from the model cancels its request
            if status is Status.INVALID:
                reason = "" if kb.is_feasible(action) else kb.why(kb.actions[action])
            kb.cancel_action(action, _RESULTS[status], "" if status is Status.SUCCESS else reason)
            for preference in list(others.values()):  # another thread joined meanwhile
                kb.request_action(action, preference)
        self._held, self._is_ready = None, False


class Careful(Behaviour):
    """A behaviour that fails on an exception, with its text as feedback, and that an interrupt stops."""

    def advance(self) -> Generator[Behaviour, None, Status]:
        """Do the work of one tick: yield the nodes that are visited before this one, and return the status."""
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
        """Stop the behaviour if it is running; called when the tree is shut down."""
        if self.status is Status.RUNNING:
            self.stop(Status.INVALID)


class KbBehaviour(Careful):
    """A leaf that uses a knowledge base; it fails on an exception, with the text as feedback.

    Attributes:
        known: number of the last event before it was ticked; None for an action, which is not ticked at one moment.
    """

    BOOKKEEPING = "known"

    def __init__(self, name: str, kb: KnowledgeBase) -> None:
        super().__init__(name)
        self.kb = kb
        self.known: int | None = None

    def stop(self, new_status: Status) -> None:
        """Call `terminate` and set the status; an exception in `terminate` turns SUCCESS into FAILURE."""
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
        with (
            self.kb.reading()
        ):  # all its questions are answered at one moment, which the trace can name
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
        """Return SUCCESS if there is no objection, else FAILURE; the objection becomes the feedback."""
        self.feedback_message = objection
        return Status.FAILURE if objection else Status.SUCCESS


class ActionBehaviour(PortsMixin, KbBehaviour):
    """A behaviour about one ROSA action, whose name is an argument or is read from the port `action`.

    Attributes:
        given: the name that the constructor was given; None if the port gives it.
    """

    INPUT_PORTS = {"action": PortInformation(str, False, "name of the ROSA action")}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it

    def __init_subclass__(cls, *, tag: str | None = None, register: bool = False) -> None:
        """Keep the class out of py_trees' registry, unless asked: there, names of classes have to be unique."""
        super().__init_subclass__(tag=tag, register=register)

    def __init__(self, name: str, kb: KnowledgeBase, action: str | None = None) -> None:
        super().__init__(name, kb)
        self.given: Final = action
        if action is not None:
            kb.is_feasible(
                action
            )  # an unknown action is found here, not in the middle of a mission

    @property
    def action(self) -> str:
        """Name of the ROSA action: as the constructor was given it, or else from the port `action`."""
        return str(self.get_input("action") if self.given is None else self.given)


class IsActionFeasible(ActionBehaviour):
    """Condition: SUCCESS while the action's status is not "unfeasible", FAILURE with the reason otherwise.

    Args:
        action: name of the ROSA action; without it, the port `action` gives it.
        during: how long the action takes [s]. It has to stay feasible for that time: at the start, at the worst ends
            of the forecasts; once it is requested, by the expected forecasts, for the time that is left.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    def __init__(
        self, name: str, kb: KnowledgeBase, action: str | None = None, *, during: float = 0.0
    ) -> None:
        super().__init__(name, kb, action)
        self.during, self.ends_too_soon = (
            during,
            False,
        )  # ends_too_soon: feasible now, but not for as long as `during`

    def update(self) -> Status:
        action, self.ends_too_soon = self.action, False
        if not self.kb.is_feasible(action):
            return self._answer(why(self.kb, action))
        began = (
            [one.start for one in self.kb.required_actions if one.action == action]
            if self.during
            else []
        )
        left = self.during - sum(self.kb.now - start for start in began)
        if left <= 0.0:
            return self._answer("")
        until = self.kb.feasible_until(action, left)
        self.ends_too_soon = (until.at if began else until.earliest) is not None
        return self._answer(
            f"{action} takes {left:.3g} s and is {until}" if self.ends_too_soon else ""
        )


class HasStatus(KbBehaviour):
    """Condition: SUCCESS while an element of the model has a status, FAILURE with the reason otherwise.

    To ask whether an action can be done, use `IsActionFeasible`: the status of an action that is requested and
    configured is "solved", not "feasible".

    Args:
        element: name of an action, function, component, design or configuration; or a view such as
            `kb.components["camera"]`, if elements of several kinds have the same name.
        status: a status that elements of this kind can have, e.g. "failure".

    Raises:
        kb.UnknownName, kb.AmbiguousName: no element, or more than one, has this name.
        kb.InvalidValue: an element of this kind never has this status.
    """

    def __init__(
        self, name: str, kb: KnowledgeBase, element: str | StatusView, status: str
    ) -> None:
        super().__init__(name, kb)
        if isinstance(element, str):
            tables: dict[str, Mapping[str, StatusView]] = {
                "action": kb.actions,
                "function": kb.functions,
            }
            tables |= {
                "component": kb.components,
                "function design": kb.designs,
                "configuration": kb.configurations,
            }
            element = meant_by(element, tables, "element", "pass the view meant, e.g. kb.")
        possible = STATUSES[element.node.kind]
        if status not in possible:
            known = ", ".join(repr(str(one)) for one in possible)
            raise InvalidValue(
                f"{element.node.kind} {element.name!r} is never {status!r}; it can be {known}"
            )
        self.element, self.wanted = element, status

    def update(self) -> Status:
        status = self.element.status
        return self._answer(
            ""
            if status == self.wanted
            else f"{self.element.name} is not {self.wanted} but {status}"
        )


class Measurement(KbBehaviour):
    """Condition: SUCCESS while the comparison holds for the latest measurement of an attribute, else FAILURE.

    Args:
        attribute: its name.
        operator: one of `>=`, `>`, `<=`, `<`.
        value: what to compare with, in the attribute's unit.
        unknown: the status to return while the attribute has no measurement, or only one that is too old.

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
            raise ValueError(f"{operator!r} is not an operator; use one of {', '.join(OPERATORS)}")
        self.attribute, self.operator, self.value = kb.attributes[attribute], operator, float(value)
        self._unknown = unknown

    def update(self) -> Status:
        attribute, measured = self.attribute, self.attribute.value
        if measured is None or attribute.is_stale:
            self.feedback_message = (
                f"{attribute.name} is not measured{'' if measured is None else ' any more'}"
            )
            return self._unknown
        holds = OPERATORS[self.operator](measured, self.value)
        return self._answer(
            ""
            if holds
            else f"{attribute.name} {measured:.6g} is not {self.operator} {self.value:.6g}"
        )


class RosaAction(ActionBehaviour):
    """Action: base class of what a mission does while the robot is configured for it.

    A subclass implements `update`, and `initialise` and `terminate` if it needs them; it need not call the base's. The
    action is requested before `initialise` and released once, after `terminate`. The result of the request follows from
    how the behaviour ends: SUCCESS is "completed", FAILURE or an exception (its text is the feedback) is "failed", an
    interruption or the shutdown of the tree is "abandoned". If the request is refused, the behaviour fails with the
    reason, and the subclass is not called. If the action becomes unfeasible while it runs, it is "abandoned", and the
    behaviour fails with the reason. To continue where it was, implement `save_progress` and `restore_progress`.

    Args:
        action: name of the ROSA action; without it, the port `action` gives it.
        preference: name of the attribute to favour when a configuration is chosen, or None; also a port.
        wait: begin only when the robot is configured for the action; until then RUNNING, with what is missing.
        timeout: how long to wait [s], by the clock of the knowledge base; then FAILURE, with what is missing.
        even_if_unfeasible: go on when the action becomes unfeasible while it runs.

    Raises:
        kb.UnknownName: no such action; the message lists the nearest ones.
    """

    BOOKKEEPING = "_saved_s"
    INPUT_PORTS = ActionBehaviour.INPUT_PORTS | {
        "preference": PortInformation(str, False, "attribute to favour", "")
    }

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
        """Name of the attribute to favour: as the constructor was given it, or else from the port, or None."""
        if self._preference is not None:
            return self._preference
        with suppress(RuntimeError):  # this leaf is not connected to a blackboard
            return self.get_input("preference") or None
        return None

    def save_progress(self) -> object | None:
        """Return how far the action has come, or None (the default) if it starts afresh next time.

        Called before `terminate` when the action is interrupted or fails, and, if the knowledge base has a store, about
        once a second while it runs; the store keeps it (as JSON) for the next program. Progress is kept by action and
        name of the behaviour, separately for each tree of a `TreeRunner`, until the action succeeds or a new mission
        begins: when a runner takes over or shuts down the tree, its root succeeds, or `forget_progress(kb)` is called.
        """
        return None

    def restore_progress(self, progress: object) -> None:
        """Continue from what `save_progress` returned; called after `initialise`, if something was saved."""

    def forget_progress(self) -> None:
        """Drop what this behaviour saved, for all actions: it starts afresh next time."""
        progress, missions = _ledger(self.kb).progress, (self._mission, _EARLIER)
        for key in [key for key in progress if key[0] in missions and key[2] == self.name]:
            del progress[key]
        for kept in [kept for kept in self.kb.history.progress if kept[1] == self.name]:
            _keep(self.kb, kept, "")

    @property
    def is_left(self) -> bool:
        """Whether an earlier program left progress for this behaviour that is not restored yet."""
        return any((key[0], key[2]) == (_EARLIER, self.name) for key in _ledger(self.kb).progress)

    def stop(self, new_status: Status) -> None:
        """Save progress, call `terminate` and release the request, also if the subclass raises.

        The status changes last: after an interrupt in here, a second call does the rest.
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
        if (
            status is Status.RUNNING
            and self.kb.store is not None
            and self.kb.now >= self._saved_s + _SAVE_S
        ):
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
