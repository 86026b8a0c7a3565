"""Managers to compare ours with in any mission: only the configuration is theirs."""

from collections.abc import Sequence
from functools import cached_property
from typing import Self

from kb import DiagnosticProblem, KnowledgeBase, Model, ReconfigurationPlan, Status
from kb.diagnostics import COMPONENT_REPORTS
from kb.planning import by_priority
from kb.views import ConfigurationView, DesignView
from missions.engine.percepts import Message
from missions.engine.runner import RosaRun
from missions.engine.settings import MissionError, Setting

Part = DesignView | ConfigurationView


class Policy(RosaRun):
    """Chooses designs and configurations in any mission; run as `--manager package:Class`."""

    is_waiting = True  # it may choose again only because time has passed

    @property
    def planner(self) -> Self:  # type: ignore[override]  # read-only here
        return self

    def pick(
        self, kb: KnowledgeBase, possible: Sequence[Part], selected: Part | None
    ) -> Part | None:
        """Return what to select of the feasible ones, by priority; None changes nothing."""
        return possible[0] if selected is None and possible else None

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose a design for every required function, and configurations for its components."""
        choice: dict[str, Part] = {}
        for function in kb.functions.values():
            if not function.is_required:
                continue
            designs = [kb.designs[name] for name in function.designs]
            design = self._choose(kb, designs, function.name, choice)
            for name in design.components if isinstance(design, DesignView) else ():
                names = kb.components[name].configurations
                self._choose(kb, [kb.configurations[part] for part in names], name, choice)
        if not choice and not any(kb.obsolete()):
            return None
        chosen = choice.items()
        return kb.select(
            {name: part.name for name, part in chosen if isinstance(part, DesignView)},
            {name: part.name for name, part in chosen if isinstance(part, ConfigurationView)},
            f"chosen by the manager {type(self).__name__}",
        )

    def _choose(
        self, kb: KnowledgeBase, parts: Sequence[Part], owner: str, choice: dict[str, Part]
    ) -> Part | None:
        """Enter a new choice; return what is selected then."""
        selected = next((part for part in parts if part.is_selected), None)
        possible = [part for part in parts if part.status is not Status.UNFEASIBLE]
        part = self.pick(kb, sorted(possible, key=by_priority), selected)
        if part is None:
            return selected
        if not isinstance(part, Part):
            title = f"pick() of {type(self).__name__} gives {part!r:.100}"
            raise MissionError(f"{title}; expected is one of those that are possible, or None")
        if selected is None or part.name != selected.name:
            choice[owner] = part
        return part


class Fixed(Policy):
    """Keeps its choice for an action until the action ends; only the task layer adapts."""


class Unmanaged(Fixed):
    """Configures each action once, and ignores measurements and failures: nothing adapts."""

    def build_model(self) -> Model:
        rows = super().build_model().plain()
        return Model.from_plain([row for row in rows if row[0] != "constraint"])

    def hear(self, message: Message) -> Sequence[DiagnosticProblem]:
        statuses = message["status"]
        heard = [each for each in statuses if each["message"].casefold() not in COMPONENT_REPORTS]
        return super().hear({**message, "status": heard})


class Random(Policy):
    """Selects random feasible designs and configurations every `period_s`; tasks adapt."""

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

    _period = 0
    _is_due = False

    @cached_property
    def _phase(self) -> float:
        return float(self.rng.random())

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        period = int(kb.now / self.values["period_s"] + self._phase)
        self._is_due = period != self._period
        self._period = period
        return super().plan(kb)

    def pick(
        self, kb: KnowledgeBase, possible: Sequence[Part], selected: Part | None
    ) -> Part | None:
        if not possible or not (self._is_due or selected is None):
            return None
        return possible[int(self.rng.integers(len(possible)))]
