"""Makes the rows of a page from a run of a mission: what its robot knows and does, and what its world shows."""

from collections.abc import Mapping

from kb import DiagnosticProblem, KnowledgeBase
from missions.baselines import open_run
from missions.engine.adaptations import Adaptation
from missions.engine.mission import Message, Verdict
from missions.engine.registry import find_mission
from missions.engine.runner import Listener, MissionRun
from missions.views.output import figure_in_words
from missions.views.recorder import Recorder
from missions.views.rows import Recorded


class RunRecorder(Listener):
    """Listens to a run that is open, and writes down what there is to see; `end` after it.

    Under a manager without a knowledge base one of our own hears the same messages and says what they mean.

    Args:
        keep: how many rows to keep, the newest; None for all.
        what_if: whether to work out what would have been if something else had been measured.
    """

    def __init__(
        self, run: MissionRun, seed: int, settings: Mapping[str, str], keep: int | None = None, *, what_if: bool = True
    ) -> None:
        self._run = run
        self._scene: tuple[str, ...] | None = None
        self._shown = self._disturbed = self._failed = 0
        self._own = None if run.controller.kb else KnowledgeBase(run.model, clock=lambda: run.world.now)
        kb, sample = run.controller.kb or self._own, run.world.sample()
        assert kb is not None
        self._measured = frozenset(kb.attributes)
        header = {
            **{"title": run.mission.name, "mission": run.mission.name, "words": run.mission.summary},
            **{"task": run.task, "manager": run.manager, "seed": seed, "settings": dict(sorted(settings.items()))},
            "signals": [name for name, _ in map(_split, sample.signals if sample else ())],
            "units": {name: unit for name, unit in map(_split, sample.signals if sample else ()) if unit},
        }
        tree = getattr(run.controller, "tree", None)
        self.recorder = Recorder(kb, tree, keep=keep, what_if=what_if, header=header)
        self._show()
        run.listen(self)

    def end(self, verdict: Verdict) -> None:
        run = self._run
        self.tick(run)
        self._show()
        figures = [list(figure_in_words(name, value, run.model)) for name, value in run.results().items()]
        shown = {"outcome": verdict.outcome, "success": verdict.success, "reason": verdict.reason, "figures": figures}
        self.recorder.put("result", 0, shown)
        self.recorder.close()

    def message(self, message: Message) -> None:
        if self._own is not None:
            self._own.receive(message)

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        self._failed += 1
        self.recorder.put("problem", self._failed, str(problem))

    def adaptation(self, adaptation: Adaptation) -> None:
        self.recorder.adapted(adaptation)

    def tick(self, run: MissionRun) -> None:
        if len(run.trace) > self._shown:
            self._shown = len(run.trace)
            self._show()

    def _show(self) -> None:
        """Write down what the world shows now, and what has happened in it."""
        recorder, run = self.recorder, self._run
        sample = run.trace[-1] if run.trace else run.world.sample()
        if sample is not None:
            recorder.posed(sample.time, sample.position)
            for signal, value in sample.signals.items():
                if _split(signal)[0] not in self._measured:
                    recorder.put("signal", signal, round(value, 4))
        scenery = run.world.scenery()
        if tuple(scenery) != self._scene:  # what is special in a place is in its name
            self._scene = tuple(scenery)
            recorder.show(scenery)
        for time, text in run.world.disturbances()[self._disturbed :]:
            self._disturbed += 1
            recorder.put("disturbance", self._disturbed, {"t": time, "words": text})
        if self._own is not None:
            for number, one in enumerate(run.actions, start=1):
                recorder.acted(number, one)


def record(mission: str, manager: str, task: str, seed: int, settings: Mapping[str, str]) -> Recorded:
    """Do a run of a mission and return what there is to see of it."""
    run = open_run(find_mission(mission), manager=manager, task=task, seed=seed, settings=settings)
    page = RunRecorder(run, seed, settings)
    page.end(run.run())
    return page.recorder.recorded


def _split(signal: str) -> tuple[str, str]:
    """Return the name of the attribute that a signal is called after, and the unit."""
    name, _, unit = signal.partition(" [")
    unit = unit.rstrip("]")
    return name.replace(" ", "_"), "" if unit == "-" else unit
