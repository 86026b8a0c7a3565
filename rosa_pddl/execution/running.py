"""The behaviour of a step: made when the step starts, ticked, and let go of however it ends."""

from collections.abc import Callable, Iterable, Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl.domain import Domain, Step
from rosa_pddl.exceptions import MissingBehaviourError, UnknownNameError, nearest
from rosa_pddl.execution.belief import Undo

__all__ = ["Factory", "Interlude", "RunningStep", "check_factories"]

Factory = Callable[[Step], Behaviour]


def check_factories(domain: Domain, behaviours: Mapping[str, Factory]) -> None:
    """Assure that each PDDL action has what makes its behaviours.

    Raises:
        MissingBehaviourError: one has not, or something that makes none.
        UnknownNameError: something is given for a PDDL action that there is not.
    """
    given = ", ".join(sorted(behaviours)) or "none"
    for schema in domain.schemas:
        if schema not in behaviours:
            message = f"no behaviour for the PDDL action {schema!r} of {domain.file}; given: {given}"
            raise MissingBehaviourError(f"{message} ({nearest(schema, behaviours)})")
        if not callable(behaviours[schema]):
            message = f"no behaviour can be made for {schema!r} from {behaviours[schema]!r}"
            raise MissingBehaviourError(f"{message}; expected what makes one for each step, such as a lambda")
    for name in behaviours:
        if name not in domain.schemas:
            message = f"a behaviour is given for {name!r}, but {domain.file} has no such PDDL action"
            raise UnknownNameError(f"{message}; {nearest(name, domain.schemas)}")


class RunningStep:
    """A step that runs; its `undo` is what its start changed in what is believed.

    Args:
        step: what is done.
        factory: makes the behaviour that does it.
        number: its number in the plan that is executed; None if it is of an earlier one.
        parent: the behaviour that ticks it.
        arguments: for the `setup` of its behaviour.

    Raises:
        MissingBehaviourError: the factory made no behaviour. What the factory or a `setup` raises comes out as it is,
            with a note that says for which step.
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
        try:
            self.behaviour = _made(factory, step)
            self._set_up(arguments)
        except Exception as error:
            error.add_note(f"it was raised when the behaviour of {step} was made")
            raise
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
        self._shut_down(self.behaviour.iterate())
        self.behaviour.parent = None

    def _set_up(self, arguments: Mapping[str, object]) -> None:
        done: list[Behaviour] = []
        try:
            for node in self.behaviour.iterate():
                done.append(node)
                node.setup(**arguments)
        except Exception:
            self._shut_down(done)
            raise

    def _shut_down(self, nodes: Iterable[Behaviour]) -> None:
        """Shut down nodes: one that raises then must not keep others from being let go of."""
        for node in nodes:
            try:
                node.shutdown()
            except Exception as error:
                node.logger.error(f"{type(error).__name__} in shutdown of {self.step}: {error}")

    def _stop(self) -> None:
        """Stop for good: a behaviour that raises in its `terminate` must not keep the executor from going on."""
        try:
            self.behaviour.stop(Status.INVALID)
        except Exception as error:
            self.behaviour.logger.error(f"{type(error).__name__} in terminate of {self.step}: {error}")
            for node in self.behaviour.iterate():
                node.status = Status.INVALID


class Interlude:
    """What is done between two steps while a plan is made: a behaviour made of the step before.

    Args:
        factory: makes it; None for nothing.
        parent: the behaviour that ticks it.
    """

    def __init__(self, factory: Factory | None, parent: Behaviour) -> None:
        self._factory, self._parent = factory, parent
        self._after: Step | None = None
        self._running: RunningStep | None = None

    @property
    def behaviours(self) -> list[Behaviour]:
        """The behaviour that runs, if one does."""
        return [] if self._running is None else [self._running.behaviour]

    def follow(self, step: Step) -> None:
        """Note that a step is over: what is done next would be made of that one."""
        self._after = step

    def go_on(self, arguments: Mapping[str, object]) -> list[Behaviour]:
        """Tick it, and begin it if that is due; return the nodes that were ticked. Once it has ended, that is it."""
        before = None
        if self._factory is not None and self._after is not None:
            before, after, self._after = self._running, self._after, None
            self._running = RunningStep(after, self._factory, None, self._parent, arguments)
        if self._running is None:
            return []
        status, _, ticked = self._running.tick()
        if status != Status.RUNNING:
            self.end()
        if before is not None:
            before.release()
        return ticked

    def end(self) -> None:
        """Let go of it."""
        running, self._running, self._after = self._running, None, None
        if running is not None:
            running.release()


def _made(factory: Factory, step: Step) -> Behaviour:
    made = factory(step)
    if not isinstance(made, Behaviour):
        message = f"for {step} what was given for {step.schema!r} made {made!r}, expected a py_trees behaviour"
        raise MissingBehaviourError(message)
    return made
