"""Managed systems and leaves of trees that follow scripts, and a clock that the test moves."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MethodType
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import UnknownName
from missions.engine.components import CommandFailed as CommandFailed
from missions.engine.components import (
    NamedComponents,
    Script,
    SimulatedComponents,
    checked_times,
)
from rosa_bt import RosaAction

LETTERS: Final = {"R": Status.RUNNING, "S": Status.SUCCESS, "F": Status.FAILURE}


class LeafMock:
    """A mocked leaf: returns a script, and counts ticks, starts and interruptions."""

    def __init__(self, outcomes: Sequence[Status]) -> None:
        self._outcomes = outcomes
        self._is_running = False
        self.ticks = self.starts = self.interruptions = 0

    def initialise(self) -> None:
        self.starts += 1

    def update(self) -> Status:
        """Return the next outcome of the script, at the end always the last one.

        Called by the leaf.
        """
        self.ticks += 1
        outcome = self._outcomes[min(self.ticks, len(self._outcomes)) - 1]
        self._is_running = outcome is Status.RUNNING
        return outcome

    def terminate(self, new_status: Status) -> None:
        self.interruptions += self._is_running and new_status is Status.INVALID
        self._is_running = False


def mock_leaf(root: Behaviour, name: str, outcomes: str) -> LeafMock:
    """Let a leaf of a tree return the outcomes of a script instead of working.

    Only its own work is replaced: a `RosaAction` still requests its action and releases it, so that
    the robot is configured for it. This works for trees read from XML, too.

    Args:
        root: of the tree, or of the subtree in which to look.
        name: of the leaf; if several have that name, they share the script.
        outcomes: one for each tick, as letters R, S and F; the last one is repeated for ever.

    Raises:
        kb.UnknownName: no leaf has that name; the message lists the nearest ones.
        ValueError: there are no outcomes, or another letter.
    """
    if not outcomes or not LETTERS.keys() >= {*outcomes}:
        raise ValueError(f"outcomes are letters R, S and F, at least one; not {outcomes!r}")
    mock = LeafMock([LETTERS[letter] for letter in outcomes])
    leaves = [leaf for leaf in root.iterate() if not leaf.children]
    names = dict.fromkeys(leaf.name for leaf in leaves)
    if name not in names:
        raise UnknownName("leaf", name, names)
    for leaf in leaves:
        if leaf.name == name:
            replace_work(leaf, mock.update, mock.initialise, mock.terminate)
    return mock


def replace_work(
    leaf: Behaviour,
    update: Callable[[], Status],
    initialise: Callable[[], object] = lambda: None,
    terminate: Callable[[Status], object] = lambda new_status: None,
) -> None:
    """Replace the methods of a leaf by these.

    A `RosaAction` still requests its action and releases it.
    """
    own: dict[str, Callable[..., object]] = {
        "update": update,
        "initialise": initialise,
        "terminate": terminate,
    }
    if isinstance(leaf, RosaAction):
        own |= {"save_progress": lambda: None, "restore_progress": lambda progress: None}
        own["halting"] = MethodType(RosaAction.halting, leaf)
    vars(leaf).update(own)


class FakeClock:
    """A clock that stands still until the test moves it; pass it as any `clock`.

    Args:
        now: what it shows first [s].
    """

    def __init__(self, now: float = 0.0) -> None:
        self._now = now

    @property
    def now(self) -> float:
        return self._now

    def __call__(self) -> float:
        return self._now

    def advance(self, seconds: float) -> float:
        """Let time pass [s]; return the time then."""
        return self.advance_to(self._now + seconds)

    def advance_to(self, time: float) -> float:
        """Let time pass until `time` [s], and return it.

        ValueError if that is in the past or not a number.
        """
        if not time >= self._now:
            raise ValueError(
                f"a clock that shows {self._now:g} s cannot be moved to {time:g} s; "
                "time only passes"
            )
        self._now = time
        return time


class ScriptedManaged(SimulatedComponents):
    """A managed system without a robot; `script` makes commands fail, hang or lie.

    Args:
        clock: gives the time; the test or the replay moves it. A command takes no time, or in a
            replay as long as recorded.
    """

    def __init__(self, clock: FakeClock) -> None:
        self._names = NamedComponents()
        super().__init__(clock, self._names)
        self.clock = clock
        self._recorded: dict[tuple[str, str], list[Script]] = {}

    def follow(
        self, commands: Iterable[tuple[str, str, float, bool]], usual: Mapping[str, float]
    ) -> None:
        """Let unscripted commands end as recorded: (verb, component, seconds, is successful).

        A command after the last recorded one of its kind ends as that did. A command of another
        kind takes the usual time of its verb [s].
        """
        self.takes = checked_times(usual)
        for verb, component, takes, is_well in commands:
            script = Script(takes, 0 if is_well else math.inf)
            self._recorded.setdefault((verb, component), []).append(script)

    def _script(self, verb: str, component: str) -> Script:
        recorded = self._recorded.get((verb, component))
        if not recorded or (verb, component) in self._scripts:
            return super()._script(verb, component)
        return recorded[min(self._counts[verb, component], len(recorded) - 1)]

    @property
    def active(self) -> frozenset[str]:
        """The components that run now, whatever was reported."""
        self.catch_up()
        return frozenset(self._names.active)
