"""A watch over a run: what was reacted to and how soon, and how long whoever manages thought about it."""

from collections.abc import Callable, Mapping
from time import perf_counter
from typing import TYPE_CHECKING, Any, cast

from kb import DiagnosticProblem
from missions.baselines.reactions import Reaction, find_reactions, mean_reactions, news_in
from missions.engine.adaptations import Adaptation
from missions.engine.components import SimulatedComponents
from missions.engine.mission import Message
from missions.engine.runner import Listener, MissionRun
from missions.suave.world import Sea

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord

__all__ = ["Aside", "WatchedSea"]


class WatchedSea(Sea):
    """A sea that sees how it is managed, and can have time go on while whoever manages it thinks.

    Thinking is what happens between the end of one `advance` and the beginning of the next. If it is charged, the sea
    moves on by as much before each command takes effect and before anything is heard: results then depend on the
    machine and are no longer the same to the byte.

    Args:
        sea: the sea, which is taken over.
        charges: whether thinking takes simulated time.
        inputs: figures that were taken from published results of the manager, by name; they show among the results.
    """

    def __init__(self, sea: Sea, *, charges: bool = False, inputs: Mapping[str, float] | None = None) -> None:
        super().__init__(sea._env)
        self._charges = charges
        self._inputs = {f"input_from_paper_{name}": value for name, value in (inputs or {}).items()}
        self._heard: list[Message] = []
        self._backlog: list[Message] = []
        self._thoughts: list[tuple[float, float]] = []
        self._since: float | None = None
        self._charged_s = 0.0

    @property
    def managed(self) -> SimulatedComponents:
        """The nodes of the vehicle."""
        nodes = super().managed
        return cast(SimulatedComponents, _Charging(nodes, self._think)) if self._charges else nodes

    @property
    def reactions(self) -> tuple[Reaction, ...]:
        """Every reaction up to now."""
        from suave_env.water import expected_altitude

        news = [one for message in self._heard for one in news_in(message)]
        return find_reactions(news, self.history, self.settings.spiral_altitude_m, expected_altitude)

    def compute_s(self, reaction: Reaction) -> float:
        """Return the time of this machine that was spent on thinking during a reaction [s]."""
        return sum(took for time, took in self._thoughts if reaction.start_s <= time < reaction.end_s)

    def advance(self, until: float) -> list[Message]:
        """Simulate until something is published or switched, at most to the time `until` [s]."""
        self._think()
        if not self._backlog and self.now <= until:
            self._backlog = super().advance(until)
        messages, self._backlog = self._backlog, []
        self._heard += messages
        self._since = perf_counter()
        return messages

    def results(self) -> Mapping[str, float | None]:
        """Return the metrics of the sea and the mean reaction times, and mark what was charged or put in."""
        charged = {"compute_charged_s": self._charged_s} if self._charges else {}
        return {**super().results(), **mean_reactions(self.reactions), **charged, **self._inputs}

    def aside(self, do: Callable[[], None]) -> None:
        """Do something that is no thinking of whoever manages."""
        if self._since is None:
            do()
            return
        thought = perf_counter() - self._since
        do()
        self._since = perf_counter() - thought

    def _think(self) -> None:
        """Take down what was thought since last time, and pay for it if that is charged."""
        if self._since is None:
            return
        took = perf_counter() - self._since
        self._thoughts.append((self.now, took))
        if self._charges:
            self._charged_s += took
            until = self.now + took
            while self.now < until:
                self._backlog += super().advance(until)
            self._since = perf_counter()


class _Charging:
    """The nodes, for which time goes on before they are told anything."""

    def __init__(self, nodes: SimulatedComponents, think: Callable[[], None]) -> None:
        self._nodes = nodes
        self._think = think

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # whatever else the nodes have
        return getattr(self._nodes, name)

    def activate(self, name: str) -> object:
        self._think()
        return self._nodes.activate(name)

    def deactivate(self, name: str) -> object:
        self._think()
        return self._nodes.deactivate(name)

    def set_parameters(self, name: str, values: Mapping[str, Any]) -> object:
        self._think()
        return self._nodes.set_parameters(name, values)


class Aside(Listener):
    """Lets others hear of a run without their time counting as thinking of whoever manages.

    Args:
        listeners: the others.
        sea: where it happens.
    """

    def __init__(self, listeners: tuple[Listener, ...], sea: WatchedSea) -> None:
        self._listeners = listeners
        self._sea = sea

    def message(self, message: Message) -> None:
        """Pass on what was published."""
        self._pass_on(lambda one: one.message(message))

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        """Pass on what could not be used."""
        self._pass_on(lambda one: one.problem(problem, time_s))

    def adaptation(self, adaptation: Adaptation) -> None:
        """Pass on an adaptation."""
        self._pass_on(lambda one: one.adaptation(adaptation))

    def action(self, text: str, time_s: float) -> None:
        """Pass on what was requested or has ended."""
        self._pass_on(lambda one: one.action(text, time_s))

    def plan(self, plan: "PlanRecord", time_s: float) -> None:
        """Pass on a task plan."""
        self._pass_on(lambda one: one.plan(plan, time_s))

    def tick(self, run: MissionRun) -> None:
        """Pass on that there was a tick."""
        self._pass_on(lambda one: one.tick(run))

    def _pass_on(self, tell: Callable[[Listener], None]) -> None:
        def tell_all() -> None:
            for listener in self._listeners:
                tell(listener)

        self._sea.aside(tell_all)
