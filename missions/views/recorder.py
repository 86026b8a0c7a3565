"""Makes the rows of pages, reports and recordings from a knowledge base and a tree."""

import logging
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from itertools import count
from math import inf, isfinite
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Parallel, Selector
from py_trees.composites import Sequence as SequenceNode
from py_trees.decorators import Decorator
from py_trees.trees import BehaviourTree
from py_trees.visitors import VisitorBase

from kb import DiagnosticProblem, Event, KnowledgeBase, ReconfigurationPlan, RequiredAction
from kb.network import Network, Node
from missions.engine.adaptations import Adaptation, AdaptationLog, is_news, plans_after
from missions.engine.mission import Message, MissionError, Sample, Verdict
from missions.engine.runner import Listener, MissionRun, RosaRun
from missions.engine.task_layer import has_plans
from missions.views.facts import cases, chain_of, described, facts_of, key_of, level_of, reasons
from missions.views.output import figure_in_words
from missions.views.report import Recorded, Rows, report, write_report
from rosa_bt import HasStatus, IsActionFeasible, TreeRunner
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.exceptions import errors_of

_log = logging.getLogger(__name__)

_LETTERS: Final = {
    Status.RUNNING: "R",
    Status.SUCCESS: "S",
    Status.FAILURE: "F",
    Status.INVALID: "",
}
_SHAPES: Final[Sequence[tuple[tuple[type, ...], str]]] = (
    ((SequenceNode, SafeSwitch), "sequence"),
    ((Selector, DoUntilUnfeasible), "selector"),
    ((Parallel,), "parallel"),
    ((Decorator,), "decorator"),
    ((IsActionFeasible, HasStatus), "condition"),
)
POSE_PERIOD_S: Final = 0.5
_REMEMBERED: Final = 2000  # events, for the chains that end with them
PLANS: Final = 256  # task plans that are remembered, for the same


class Recorder:
    """Writes down what a robot knows and does, as rows.

    Create it in the robot's program before the first tick.

        recorder = Recorder(kb, tree)
        ...                                  # the robot does its work
        recorder.report("run.html")

    Args:
        tree: the tree that decides, a `TreeRunner` or a py_trees tree; None if there is none. It
            may change.
        title: of the page; by default the name of the model.
        pose: returns the robot's position (x, y, z) [m], world frame, z up; called at most twice a
            second.
        scene: what the map shows: points (n, 2) [m], world frame, by name.
        keep: how many of the newest rows to keep; None for all.
        what_if: whether to work out, whenever news changes a status, what would be feasible if
            another value had been measured.
        header: of a run whose adaptations come by `adapted` or as rows, and are not looked for
            here.

    Raises:
        MissionError: `tree` is a behaviour, not a tree that ticks one.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        tree: TreeRunner | BehaviourTree | None = None,
        *,
        title: str = "",
        pose: Callable[[], Sequence[float]] | None = None,
        scene: Mapping[str, Iterable[Sequence[float]]] | None = None,
        keep: int | None = None,
        what_if: bool = True,
        header: Mapping[str, Any] | None = None,
    ) -> None:
        if isinstance(tree, Behaviour):
            raise MissionError(
                f"{tree.name!r} is a behaviour; give the TreeRunner or py_trees tree that ticks it"
            )
        self.rows = Rows(keep)
        self.header: dict[str, Any] = {
            "title": title or kb.model.name,
            "words": "",
            "task": "",
            "manager": "ours",
            "seed": None,
            "settings": {},
            **(header or {}),
        }
        self.kb = kb
        self._pose = pose
        self._what_if = what_if
        self._own = None
        if header is None:
            self._own = AdaptationLog(kb, self.adapted)
        self._network: Network | None = None
        self._elements: dict[str, dict[str, Any]] = {}  # by key, as they are in that network
        self._counts = Counter[str]()  # by track
        self._troubles: set[object] = set()
        self._posed_at = -inf
        self._task_plans = deque[Any](maxlen=PLANS)
        self._last_plans: dict[Any, Any] = {}  # by behaviour
        self._look(kb.now)
        for action in kb.required_actions:
            self.acted(action.number, action)
        self._tree = (
            _TreeRows(self, tree.tree if isinstance(tree, TreeRunner) else tree) if tree else None
        )
        if scene is not None:
            self.show(scene)
        self._stop = kb.subscribe(self._hear)

    def show(self, scene: Mapping[str, Iterable[Sequence[float]]]) -> None:
        """Set what the map shows from now on: points (n, 2) [m], world frame, by name."""
        shown = []
        for name, points in scene.items():
            pairs = [[round(float(point[0]), 3), round(float(point[1]), 3)] for point in points]
            shape = "line" if len(pairs) > 1 else "point"
            shown.append({"name": name, "points": pairs, "shape": shape})
        self.put("scene", 0, shown)

    def put(self, track: str, key: int | str, value: object, time: float | None = None) -> bool:
        """Add a row at a time [s], by default now, to a track such as "signal".

        Returns:
            Whether that is news.
        """
        return self.rows.put(self.kb.now if time is None else time, track, key, value)

    def log(
        self,
        track: str,
        level: str,
        words: str,
        time: float | None = None,
        key: int | str | None = None,
        **more: object,
    ) -> None:
        """Add an entry of the event log, with what else a page shows of it.

        The time [s] is now by default, the key the next number of the track. A level is "info",
        "warning" or "error".
        """
        if key is None:
            self._counts[track] += 1
            key = self._counts[track]
        now = self.kb.now
        entry: dict[str, Any] = {
            "t": now if time is None else time,
            "level": level,
            "words": words,
            **more,
        }
        self.put(track, key, entry, min(now, entry["t"]))

    @property
    def recorded(self) -> Recorded:
        return Recorded(self.header, self.rows.since(0)[1])

    def report(self, path: str) -> None:
        """Write the run up to now to a file, as one self-contained page."""
        write_report(path, self.recorded)

    def close(self) -> None:
        """Stop recording; the rows stay."""
        if self._own is not None:
            self._own.settle()
        self._stop()
        if self._tree is not None:
            self._tree.let_go()
        self.put("now", 0, "end")

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 50rem; border: 0"
        return f'<iframe srcdoc="{escape(report(self.recorded))}" style="{style}"></iframe>'

    # ---------------------------------------------------------------- events of the knowledge base

    def _hear(self, event: Event) -> None:
        time = event.time
        if event.verb == "measure":
            self.put("value", f"attribute {event.subject}", event.arguments[1], time)
            if not event.changes:
                return
        more: dict[str, Any] = {"verb": event.verb, "changes": event.changes}
        self.log("event", level_of(event), event.text, time, event.number, **more)
        self._look(time)
        if event.verb in ("request_action", "cancel_action"):
            records = reversed(self.kb.history.actions)
            record = next(record for record in records if record.action == event.subject)
            self.acted(record.number, record)
        for plan in reversed(self.kb.plans):
            self.put("plan", plan.number, {"words": str(plan), **_span(plan)}, time)
            if plan.end is not None and plan.end < time:
                break
        is_change = any(change.kind != "constraint" for change in event.changes)
        if self._what_if and is_change and is_news(self.kb, event):
            self._suppose(time)
        if self._own is not None and self._tree is None:
            self._own.ticking(time)
            self._own.settle()

    def _look(self, time: float) -> None:
        """Write rows for what has changed of any element, and why."""
        with self.kb.reading() as state:
            network = state.network
            known = facts_of(state)
        if network is not self._network:
            self._network = network
            gone = self._elements
            self._elements = {key: described(node) for key, node, _ in known}
            for key, element in {**dict.fromkeys(gone), **self._elements}.items():
                self.put("element", key, element, time)
        changed: dict[str, Node] = {}
        for key, node, facts in known:
            is_news = [self.put(track, key, value, time) for track, value in facts.items()]
            if any(is_news) and node.kind not in ("attribute", "constraint"):
                changed[key] = node
                if node.kind in ("function design", "configuration"):
                    changed[key_of(node.used_by[0])] = node.used_by[0]
        for key, node in changed.items():
            for track, reason in reasons(self.kb, node).items():
                self.put(track, key, reason, time)

    # ---------------------------------------------------------------- the task layer

    def ticking(self) -> None:
        """Begin a tick; the manager has been updated since the last one."""
        if self._own is not None:
            self._own.settle()
            self._own.ticking(self.kb.now)

    def ticked(self, planning: Iterable[Any]) -> None:
        """End a tick in which these behaviours may have made task plans."""
        made = []
        for behaviour in planning:
            for plan in plans_after(self._last_plans.get(behaviour), behaviour.plans):
                self._last_plans[behaviour] = plan
                made.append(plan)
                steps = list(map(str, plan.steps))
                level = "info" if plan.outcome.is_solved else "warning"
                result = ", ".join(steps) or plan.message or plan.reason
                words = f"planner ({plan.engine}): {plan.outcome}; {result}"
                more: dict[str, Any] = {
                    "outcome": str(plan.outcome),
                    "reason": plan.reason,
                    "steps": steps,
                }
                self.log("taskplan", level, words, plan.at_s, **more)
        self._task_plans += made
        if self._own is not None:
            self._own.settle(made)
        if self._pose is not None and self.kb.now >= self._posed_at + POSE_PERIOD_S - 1e-9:
            self._posed_at = self.kb.now
            self.posed(self.kb.now, self._pose())

    def posed(self, time: float, position: Sequence[float]) -> None:
        """Write the robot's position (x, y, z) [m], unless it is not known (NaN)."""
        if all(map(isfinite, position)):
            self.put("pose", 0, [round(float(metres), 3) for metres in position], time)

    def acted(self, number: int, action: RequiredAction) -> None:
        """Write an action that has begun or ended."""
        self.put("action", number, {"action": f"action {action.action}", **_span(action)})

    def adapted(self, adaptation: Adaptation) -> None:
        """Write an adaptation that is over, with the chain from cause to effect."""
        log = self.kb.log
        kind = adaptation.kind
        more: dict[str, Any] = {
            "kind": kind,
            "cause": adaptation.trigger,
            "decided": adaptation.reason,
            "changed": adaptation.change,
            "reaction": adaptation.reaction_s,
            "chain": chain_of(adaptation, [*log.since(log.last - _REMEMBERED)], self._task_plans),
        }
        words = f"{kind} adaptation: {adaptation.change}; why: {adaptation.reason}"
        self.log("adaptation", "info", words, adaptation.at_s, **more)
        if self._own is not None:
            self._own.adaptations.clear()  # the row is enough
        if self._what_if:
            self._suppose(self.kb.now)

    def _suppose(self, time: float) -> None:
        """Work out and write what would be feasible if other values had been measured."""
        self.put("whatif", 0, cases(self.kb), time)

    def trouble(self, words: str, about: object = None) -> None:
        """Write what went wrong, in a sentence, once about each thing."""
        if (about or words) not in self._troubles:
            self._troubles.add(about or words)
            self.log("problem", "error", words)

    def elements_of(self, behaviour: Behaviour) -> list[str]:
        """Return the key of the action of a behaviour in a list, empty if it has none."""
        try:
            key = f"action {behaviour.action}"  # type: ignore[attr-defined]  # if it has one
        except Exception:  # py_trees raises several kinds if a port is not connected yet
            return []
        return [key] if key in self._elements else []


class _TreeRows(VisitorBase):
    """Writes the statuses of a tree after each tick, and the tree when it has changed."""

    def __init__(self, recorder: Recorder, tree: BehaviourTree) -> None:
        super().__init__(full=False)
        self._recorder = recorder
        self._behaviours = tree
        self._ids: dict[Behaviour, int] = {}
        self._below: list[tuple[Behaviour, list[Behaviour]]] = []
        self._planning: list[Behaviour] = []
        self._ticked: dict[Behaviour, list[str]] = {}
        self._numbers = count()
        self._describe()
        tree.add_visitor(self)

    def let_go(self) -> None:
        if self in self._behaviours.visitors:
            self._behaviours.visitors.remove(self)

    def initialise(self) -> None:
        self._ticked.clear()
        self._harmlessly(self._recorder.ticking)

    def run(self, behaviour: Behaviour) -> None:
        self._ticked[behaviour] = [_LETTERS[behaviour.status], behaviour.feedback_message]

    def finalise(self) -> None:
        self._harmlessly(self._note)

    def _harmlessly(self, look: Callable[[], None]) -> None:
        """Call `look`; log what it raises, so that the robot goes on."""
        try:
            look()
        except Exception as error:
            _log.exception("a tick is not shown in full")
            self._recorder.trouble(f"a tick is not shown in full: {error!r}")

    def _note(self) -> None:
        recorder = self._recorder
        for behaviour, _ in errors_of(self._behaviours.root):
            recorder.trouble(f"{behaviour.name}: {behaviour.feedback_message}", behaviour)
        is_news = any(parent.children != children for parent, children in self._below)
        if is_news:
            self._describe()
        for behaviour, uid in self._ids.items():
            since_before = [_LETTERS[behaviour.status].lower(), behaviour.feedback_message]
            is_news |= recorder.put("node", uid, self._ticked.get(behaviour, since_before))
        if is_news:
            recorder.put("tick", 0, self._behaviours.count)
        recorder.ticked(self._planning)

    def _describe(self) -> None:
        recorder = self._recorder
        nodes = []
        parents: list[tuple[Behaviour, int | None]] = [(self._behaviours.root, None)]
        present: dict[Behaviour, int] = {}
        while parents:
            behaviour, parent = parents.pop()
            if behaviour in present:
                continue
            uid = self._ids[behaviour] if behaviour in self._ids else next(self._numbers)
            present[behaviour] = uid
            parents += [(child, uid) for child in reversed(behaviour.children)]
            about = recorder.elements_of(behaviour)
            kind = type(behaviour).__name__
            nodes.append([uid, parent, kind, behaviour.name, _shape(behaviour), about])
        for behaviour, uid in self._ids.items():
            if behaviour not in present:
                recorder.put("node", uid, None)
        self._ids = present
        self._below = [(behaviour, list(behaviour.children)) for behaviour in present]
        self._planning = list(filter(has_plans, present))
        recorder.put("tree", 0, {"name": self._behaviours.root.name, "nodes": nodes})


def _shape(behaviour: Behaviour) -> str:
    for kinds, shape in _SHAPES:
        if isinstance(behaviour, kinds):
            return shape
    if has_plans(behaviour):
        return "plan"
    return "other" if behaviour.children else "action"


def _span(record: RequiredAction | ReconfigurationPlan) -> dict[str, Any]:
    return {"start": record.start, "end": record.end, "result": record.result}


class RunRecorder(Listener):
    """Listens to a mission's run and writes its rows; call `end` after the run.

    If the manager has no knowledge base, one is made here; it hears the same messages, for the
    statuses and reasons.

    Args:
        keep: how many of the newest rows to keep; None for all.
        what_if: whether to work out what would be feasible if other values had been measured.
    """

    def __init__(
        self,
        run: MissionRun,
        seed: int,
        settings: Mapping[str, str],
        keep: int | None = None,
        *,
        what_if: bool = True,
    ) -> None:
        self._run = run
        self._scene: tuple[str, ...] | None = None
        is_ours = isinstance(run, RosaRun)
        kb = run.kb if is_ours else KnowledgeBase(run.model, clock=lambda: run.world.now)
        self._own = None if is_ours else kb
        self._sample = run.ask("sample")
        signals = self._sample.signals if self._sample else ()
        header = {
            "title": run.mission.name,
            "words": run.mission.summary,
            "task": run.task,
            "manager": run.manager,
            "seed": seed,
            "settings": dict(sorted(settings.items())),
            "signals": list(map(_name_of, signals)),
        }
        self.recorder = Recorder(kb, run.tree, keep=keep, what_if=what_if, header=header)
        self._show()
        run.listen(self)

    def end(self, verdict: Verdict) -> None:
        run = self._run
        self._show()
        figures = [figure_in_words(name, value, run.model) for name, value in run.results().items()]
        level = "info" if verdict.success else "error"
        words = f"{verdict.outcome}: {verdict.reason}"
        more = {name: getattr(verdict, name) for name in ("outcome", "success", "reason")}
        self.recorder.log("result", level, words, key=0, figures=figures, **more)
        self.recorder.close()

    def message(self, message: Message) -> None:
        if self._own is not None:
            self._own.receive(message)

    def problem(self, problem: DiagnosticProblem, time_s: float) -> None:
        self.recorder.trouble(str(problem))

    def adaptation(self, adaptation: Adaptation) -> None:
        self.recorder.adapted(adaptation)

    def sample(self, sample: Sample | None) -> None:
        self._sample = sample
        self._show()

    def _show(self) -> None:
        """Write the sample, the scenery and the new disturbances of the world."""
        recorder = self.recorder
        run = self._run
        sample = self._sample
        if sample is not None:
            recorder.posed(sample.time, sample.position)
            for signal, value in sample.signals.items():
                if _name_of(signal) not in recorder.kb.attributes:  # it is written as a value
                    recorder.put("signal", signal, round(value, 4))
        scenery = run.ask("scenery")
        if tuple(scenery) != self._scene:  # names alone tell that it has changed
            self._scene = tuple(scenery)
            recorder.show(scenery)
        for number, (time, text) in enumerate(run.disturbances(), start=1):
            recorder.log("disturbance", "warning", text, time, number)
        if self._own is not None:
            for number, action in enumerate(run.actions, start=1):
                recorder.acted(number, action)


def _name_of(signal: str) -> str:
    """Return the attribute in the name of a signal, e.g. of "water visibility [m]"."""
    return signal.partition(" [")[0].replace(" ", "_")
