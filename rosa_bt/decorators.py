"""Decorators that py_trees has no namesake for."""

from collections.abc import Iterator

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator

__all__ = ["UntilSuccess"]


class UntilSuccess(Decorator):
    """RUNNING until the child succeeds; a child that fails is tried once more in the same tick.

    Without the second try there would be a tick in which nothing is being done, and so nothing required: the robot
    would be taken apart between two actions and put together again a moment later.
    """

    def tick(self) -> Iterator[Behaviour]:
        """Tick the child, and once more if it failed."""
        yield from self.decorated.tick()
        if self.decorated.status is Status.FAILURE:
            yield from self.decorated.tick()
        new_status = self.update()
        if new_status is not Status.RUNNING:
            self.stop(new_status)
        self.status = new_status
        yield self

    def update(self) -> Status:
        """Return the child's status, RUNNING for a failure."""
        return Status.RUNNING if self.decorated.status is Status.FAILURE else self.decorated.status
