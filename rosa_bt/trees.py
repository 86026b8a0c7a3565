"""Running a tree in somebody else's time: the clock of a simulator, a recording or the wall."""

from collections.abc import Callable

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.trees import BehaviourTree

__all__ = ["TreeRunner"]


class TreeRunner:
    """Ticks a tree at a fixed period of a clock that is handed in.

    Args:
        root: the tree.
        clock: gives the time [s].
        period: from one tick to the next [s].

    Attributes:
        tree: the py_trees tree, for visitors and handlers.
        due: when the next tick is due [s].
    """

    def __init__(self, root: Behaviour, *, clock: Callable[[], float], period: float = 0.1) -> None:
        if not period > 0:
            raise ValueError(f"the period of a tree is more than 0 s, not {period!r}")
        self.tree = BehaviourTree(root)
        self._clock = clock
        self._period = period
        self._start = clock()
        self._ticks = 0

    @property
    def due(self) -> float:
        """When the next tick is due [s]."""
        return self._start + self._ticks * self._period

    @property
    def status(self) -> Status:
        """Status of the root after the last tick."""
        return self.tree.root.status

    def update(self) -> bool:
        """Tick once if a tick is due; tell whether it was. Ticks that were missed are not made up for."""
        now = self._clock()
        if now < self.due:
            return False
        self.tick()
        self._ticks = int((now - self._start) / self._period + 1e-9) + 1
        return True

    def tick(self) -> None:
        """Tick once now.

        Raises:
            Exception: what a behaviour raised, after every running behaviour was stopped, so that nothing stays open.
        """
        try:
            self.tree.tick()
        except Exception:
            self._stop()
            raise

    def shutdown(self) -> None:
        """Stop what is running, so that every request is released, and shut the tree down."""
        self._stop()
        self.tree.shutdown()

    def _stop(self) -> None:
        """Stop each behaviour that is running, also below a root that no longer is because a sibling raised."""
        errors = []
        for behaviour in list(self.tree.root.iterate()):
            try:
                if behaviour.status is Status.RUNNING:
                    behaviour.stop(Status.INVALID)
            except Exception as error:  # the others have to be stopped all the same
                errors.append(error)
        if errors:
            raise errors[0]
