"""The behaviour of a step: made when the step starts, ticked, and let go of however it ends."""

from collections.abc import Callable, Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl.belief import Undo
from rosa_pddl.domain import Step

__all__ = ["Factory", "RunningStep"]

Factory = Callable[[Step], Behaviour]


class RunningStep:
    """A step that runs; its `undo` is what its start changed in what is believed.

    Args:
        step: what is done.
        factory: makes the behaviour that does it.
        number: its number in the plan that is executed; None if it is of an earlier one.
        parent: the behaviour that ticks it.
        arguments: for the `setup` of its behaviour.
    """

    def __init__(
        self,
        step: Step,
        factory: Factory,
        number: int | None,
        parent: Behaviour,
        arguments: Mapping[str, object],
    ) -> None:
        self.step, self.number = step, number
        self.undo = Undo()
        self.behaviour = factory(step)
        for node in self.behaviour.iterate():
            node.setup(**arguments)
        self.behaviour.parent = parent

    def tick(self) -> tuple[Status, str, list[Behaviour]]:
        """Tick the behaviour; return its status, what it says, and the nodes that were ticked.

        Whatever a step's behaviour raises is that step's failure, not the tree's.
        """
        ticked: list[Behaviour] = []
        try:
            ticked.extend(self.behaviour.tick())
        except Exception as error:
            self._stop()
            return Status.FAILURE, f"{type(error).__name__}: {error}", ticked
        return self.behaviour.status, self.behaviour.feedback_message, ticked

    def release(self) -> None:
        """Stop the behaviour if it still runs, and let go of it."""
        if self.behaviour.status == Status.RUNNING:
            self._stop()
        for node in self.behaviour.iterate():
            node.shutdown()
        self.behaviour.parent = None

    def _stop(self) -> None:
        """Stop for good: a behaviour that raises in its `terminate` must not keep the executor from going on."""
        try:
            self.behaviour.stop(Status.INVALID)
        except Exception as error:
            self.behaviour.logger.error(f"{type(error).__name__} in terminate: {error}")
            for node in self.behaviour.iterate():
                node.status = Status.INVALID
