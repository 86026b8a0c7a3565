"""Managers to compare ours with in any mission: task layer and world stay, only the configuration is theirs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from kb import KnowledgeBase, Model, ReconfigurationPlan, Status
from kb.diagnostics import COMPONENT_REPORTS, COMPONENT_VALUES
from kb.planning import by_priority
from kb.views import ConfigurationView, DesignView
from missions.engine.managers import ManagerBase, manager_name
from missions.engine.mission import MISSION_STATUS, Message, Mission, MissionError, World, built
from missions.engine.runner import RosaRun
from missions.engine.settings import RunSettings, Setting

if TYPE_CHECKING:
    from numpy.random import Generator

Part = DesignView | ConfigurationView


class Policy(ManagerBase):
    """Chooses designs and configurations in any mission; one of your own is run as `--manager package:Class`.

    Attributes:
        options: settings that can be given from outside; their values are in `given`.
        adapts_tasks: whether actions become unfeasible when a constraint is violated or a component fails.
        tasks: names of the task layers that it goes with.
        model: the model with the designs and configurations to choose from.
        rng: random generator, its only source of chance.
    """

    adapts_tasks: ClassVar[bool] = True
    is_waiting = True  # it may choose again only because time has passed

    def __init__(self, model: Model, rng: "Generator", given: Mapping[str, Any]) -> None:
        self.model = model
        self.rng = rng
        self.given = given

    @classmethod
    def open(
        cls,
        mission: Mission,
        task: str,
        world: World,
        settings: RunSettings,
        rng: "Generator",
        options: Mapping[str, Any],
    ) -> RosaRun:
        policy = cls(mission.model(), rng, options)
        name = manager_name(cls)
        title = f"what alter() of {name} gives"
        altered = built(title, Mission, partial(policy.alter, mission, world))
        return RosaRun(altered, task, world, settings, name, policy, policy.hear)

    def pick(
        self, kb: KnowledgeBase, possible: Sequence[Part], selected: Part | None
    ) -> Part | None:
        """Return what to select among the feasible ones, which come by priority; None changes nothing."""
        return possible[0] if selected is None and possible else None

    def alter(self, mission: Mission, world: World) -> Mission:
        """Return the mission as it is run under this manager."""
        return (
            mission
            if self.adapts_tasks
            else replace(mission, model=lambda: _unconstrained(mission.model()))
        )

    def hear(self, message: Message) -> Message:
        """Return a message as the knowledge base receives it."""
        return (
            message
            if self.adapts_tasks
            else {**message, "status": [_as_percept(one) for one in message["status"]]}
        )

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose a design for every required function, and a configuration for every component of it."""
        designs: dict[str, str] = {}
        configurations: dict[str, str] = {}
        for function in kb.functions.values():
            if function.is_required:
                design = self._choose(
                    kb, [kb.designs[name] for name in function.designs], function.name, designs
                )
                for name in design.components if isinstance(design, DesignView) else ():
                    parts = [
                        kb.configurations[configuration]
                        for configuration in kb.components[name].configurations
                    ]
                    self._choose(kb, parts, name, configurations)
        if not (designs or configurations or any(kb.obsolete())):
            return None
        return kb.select(designs, configurations, f"chosen by the manager {type(self).__name__}")

    def _choose(
        self, kb: KnowledgeBase, parts: Sequence[Part], whole: str, chosen: dict[str, str]
    ) -> Part | None:
        """Enter a new choice in `chosen`; return what is selected then."""
        selected = next((part for part in parts if part.is_selected), None)
        possible = [part for part in parts if part.status is not Status.UNFEASIBLE]
        made = self.pick(kb, sorted(possible, key=by_priority), selected)
        if made is not None and not isinstance(made, Part):
            said = f"pick() of {type(self).__name__} gives {made!r:.100}"
            raise MissionError(f"{said}; expected is one of those that are possible, or None")
        if made is None or (selected is not None and made.name == selected.name):
            return selected
        chosen[whole] = made.name
        return made


class Fixed(Policy):
    """Keeps its choice for an action until the action ends; only the task layer adapts."""

    options = (
        Setting(
            "use", "", "-", "designs and configurations, separated by commas; else by priority", "-"
        ),
    )

    def __init__(self, model: Model, rng: "Generator", given: Mapping[str, Any]) -> None:
        super().__init__(model, rng, given)
        self.wanted = [name.strip() for name in given["use"].split(",") if name.strip()]
        known = [*model.designs, *model.configurations]
        for name in self.wanted:
            if name not in known:
                raise MissionError(f"setting use names {name!r}; the model has {', '.join(known)}")

    def pick(
        self, kb: KnowledgeBase, possible: Sequence[Part], selected: Part | None
    ) -> Part | None:
        wanted = [one for one in possible if one.name in self.wanted]
        return super().pick(kb, wanted or possible, selected)


class Unmanaged(Fixed):
    """Configures each action once, and ignores measurements and failures; neither task nor architecture adapts."""

    adapts_tasks = False


class Random(Policy):
    """Selects random feasible designs and configurations, anew every `period_s`; the task layer adapts."""

    options = (
        Setting(
            "period_s",
            15.0,
            "s",
            "from one choice to the next",
            "as SUAVE's random manager",
            low=0.1,
        ),
    )

    def __init__(self, model: Model, rng: "Generator", given: Mapping[str, Any]) -> None:
        super().__init__(model, rng, given)
        self._turn, self._is_due, self._phase = 0, False, float(rng.random())

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        turn = int(kb.now / self.given["period_s"] + self._phase)
        self._is_due = turn != self._turn
        self._turn = turn
        return super().plan(kb)

    def pick(
        self, kb: KnowledgeBase, possible: Sequence[Part], selected: Part | None
    ) -> Part | None:
        if not possible or not (self._is_due or selected is None):
            return None
        return possible[int(self.rng.integers(len(possible)))]


class ByHand(Policy):
    """Leaves all to the hand-written tree of the mission, `Mission.by_hand`, which commands the components itself.

    The tree reads measurements from the knowledge base, and from the percepts whether "NAME has failed".
    """

    adapts_tasks = False
    tasks = ("bt",)

    @classmethod
    def refusal(cls, mission: Mission) -> str:
        if mission.by_hand is not None:
            return ""
        return (
            f"mission {mission.name} has no hand-written tree; give it by_hand=lambda kb, "
            "percepts, managed: ..., or take another manager"
        )

    def alter(self, mission: Mission, world: World) -> Mission:
        by_hand = mission.by_hand
        assert by_hand is not None  # `refusal` has refused the mission otherwise
        return replace(
            super().alter(mission, world),
            tree=lambda kb, percepts: by_hand(kb, percepts, world.managed),
        )

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        return None


def _unconstrained(model: Model) -> Model:
    for constraint in model.constraints:
        model.remove(constraint)
    return model


def _as_percept(status: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a report on components as a percept, which makes nothing unfeasible."""
    if str(status["message"]).strip().casefold() not in COMPONENT_REPORTS:
        return status
    verbs = {
        name: COMPONENT_VALUES.get(str(word).strip().casefold())
        for name, word in status["values"].items()
    }
    said = {f"{name} has failed": verb == "component_failed" for name, verb in verbs.items()}
    return {**status, "message": MISSION_STATUS, "values": said}
