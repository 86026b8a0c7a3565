"""Makes the rows of pages, reports and recordings from a knowledge base and a tree."""

import logging
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
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
from missions.engine.adaptations import Adaptation, AdaptationLog, is_news, plans_after
from missions.engine.mission import Message, MissionError, Sample, Verdict
from missions.engine.runner import Listener, MissionRun, RosaRun
from missions.engine.task_layer import has_plans
from missions.views.facts import KINDS, ElementTable, Names, cases, chain_of, level_of
from missions.views.output import figure_in_words, plain
from missions.views.report import Recorded, Rows, framed, write_report
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
        units: of attributes, by name, e.g. {"water_visibility": "m"}.
        pose: returns the robot's position (x, y, z) [m], world frame, z up; called at most twice a
            second.
        scene: what the map shows: points (n, 2) [m], world frame, by name.
        keep: how many of the newest rows to keep; None for all.
        what_if: whether to work out, whenever news changes a status, what would be feasible if
            another value had been measured.
        header: of a run whose adaptations come by `adapted` or as rows, and are not looked for
            here; has the units.

    Raises:
        MissionError: `tree` is a behaviour, not a tree that ticks one.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        tree: TreeRunner | BehaviourTree | None = None,
        *,
        title: str = "",
        units: Mapping[str, str] | None = None,
        pose: Callable[[], Sequence[float]] | None = None,
        scene: Mapping[str, Iterable[Sequence[float]]] | None = None,
        keep: int | None = None,
        what_if: bool = True,
        header: Mapping[str, Any] | None = None,
    ) -> None:
        self.rows = Rows(keep)
        self.header: dict[str, Any] = {
            "live": False,
            "title": title or kb.model.name,
            "model": kb.model.name,
            "units": dict(units or {}),
            "mission": "",
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
        self._elements = ElementTable(kb)
        self._standing: dict[tuple[int, str], bool | str] = {}
        self._events: deque[Event] = deque(maxlen=_REMEMBERED)
        self._supposed = self._adapted = self._planned = self._troubles = 0
        self._posed_at = -inf
        self._task_plans: list[Any] = []
        self._unsettled: list[Any] = []  # those of these that were made since the last tick
        self._last_plans: dict[Any, Any] = {}  # by behaviour
        if isinstance(tree, Behaviour):
            raise MissionError(
                f"{tree.name!r} is a behaviour; give the TreeRunner or py_trees tree that ticks it"
            )
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
            shown.append(
                {"name": name, "points": pairs, "shape": "line" if len(pairs) > 1 else "point"}
            )
        self.rows.put(self.kb.now, "scene", 0, shown)

    def put(self, track: str, key: int | str, value: object, time: float | None = None) -> None:
        """Add a row at a time [s], by default now, to a track such as "signal" or "problem"."""
        self.rows.put(self.kb.now if time is None else time, track, key, value)

    @property
    def names(self) -> Names:
        """The number of each element, by kind and name."""
        return self._elements.names

    @property
    def recorded(self) -> Recorded:
        return Recorded(self.header, self.rows.since(0)[1])

    def report(self, path: str) -> None:
        """Write the run up to now to a file, as one self-contained page."""
        write_report(path, self.recorded)

    def close(self) -> None:
        """Stop recording; the rows stay."""
        self._settle()
        self._stop()
        if self._tree is not None:
            self._tree.let_go()
        self.rows.put(self.kb.now, "now", 0, "end")

    def _repr_html_(self) -> str:
        return framed(self.recorded)

    # ---------------------------------------------------------------- events of the knowledge base

    def _hear(self, event: Event) -> None:
        time = event.time
        if event.verb == "measure":
            if ("attribute", event.subject) not in self.names:
                self._look(time)
            self.rows.put(time, "value", self.names["attribute", event.subject], event.arguments[1])
            if not event.changes:
                return
        self._events.append(event)
        shown = {"verb": event.verb, "words": event.text, "kind": str(event.kind)}
        shown["level"] = level_of(event)
        plain_event = event.to_json()
        shown |= {name: plain_event[name] for name in ("cause", "changes") if name in plain_event}
        self.rows.put(time, "event", event.number, shown)
        self._look(time, event)
        self._note_records(event)
        if (
            self._what_if
            and any(change.kind != "constraint" for change in event.changes)
            and is_news(self.kb, event)
        ):
            self.suppose(time)
        if self._own is not None and self._tree is None:
            self._own.ticking(time)
            self._settle()

    def _settle(self) -> None:
        if self._own is not None:
            self._own.settle(self._unsettled)
            self._unsettled = []

    def _look(self, time: float, event: Event | None = None) -> None:
        """Write rows for what an event has changed of any element, and why.

        Without an event, for all there is.
        """
        kinds: Collection[str] = {change.kind for change in event.changes} if event else KINDS
        if event is None or event.verb == "amend":
            kinds = KINDS
            for number, element in self._elements.describe(self.header["units"]):
                self.rows.put(time, "element", number, element)
        changed: dict[int, str] = {}
        for number, kind, track, value in self._elements.standing(kinds):
            before = self._standing.get((number, track))
            if value == before:
                continue
            self._standing[number, track] = value
            changed[number] = kind
            if value or before is not None:
                self.rows.put(time, track, number, value if track == "status" else int(value))
        owners: dict[int, None] = {}
        for number, kind in changed.items():
            if kind in ("constraint", "attribute"):
                continue
            for track, value in self._elements.explain(number).items():
                self.rows.put(time, track, number, value)
            owner = self._elements.owner(number)
            if owner is not None and owner not in changed:
                owners[owner] = None
        for owner in owners:
            for track, value in self._elements.choice(owner).items():
                self.rows.put(time, track, owner, value)

    def _note_records(self, event: Event) -> None:
        """Write rows for the action, plan or parameters that an event changed."""
        time = event.time
        rows = self.rows
        names = self.names
        if event.verb in ("request_action", "cancel_action"):
            records = reversed(self.kb.history.actions)
            record = next(record for record in records if record.action == event.subject)
            self.acted(record.number, record)
        elif event.plan is not None or event.verb == "finish_plan":
            for plan in reversed(self.kb.plans):
                shown = {"words": str(plan), "cause": plan.cause, **_ending(plan)}
                for word in ("activate", "deactivate"):
                    shown[word] = [names["component", name] for name in getattr(plan, word)]
                shown["configurations"] = [names["configuration", name] for name in plan.parameters]
                rows.put(time, "plan", plan.number, shown)
                if plan.end is not None and plan.end < time:
                    break
        if event.verb in ("finish_attempt", "component_active"):
            for name, view in self.kb.components.items():
                if view.parameters_in_force:
                    rows.put(
                        time,
                        "parameters",
                        names["component", name],
                        plain(view.parameters_in_force),
                    )

    # ---------------------------------------------------------------- the task layer

    def ticking(self) -> None:
        """Begin a tick; the manager has been updated since the last one."""
        self._settle()
        if self._own is not None:
            self._own.ticking(self.kb.now)
        with self.kb.reading():  # facts may be told by other threads than the one that ticks
            del self._task_plans[:-PLANS]

    def ticked(self, planning: Iterable[Any]) -> None:
        """End a tick in which these behaviours may have made task plans."""
        for behaviour in planning:
            for plan in plans_after(self._last_plans.get(behaviour), behaviour.plans):
                self._last_plans[behaviour] = plan
                self._planned += 1
                self._task_plans.append(plan)
                self._unsettled.append(plan)
                shown = {name: getattr(plan, name) for name in ("engine", "reason", "message")}
                shown |= {
                    "asked": plan.at_s,
                    "outcome": str(plan.outcome),
                    "solved": plan.outcome.is_solved,
                }
                self.put(
                    "taskplan", self._planned, shown | {"steps": [str(step) for step in plan.steps]}
                )
        if self._pose is not None and self.kb.now >= self._posed_at + POSE_PERIOD_S - 1e-9:
            self._posed_at = self.kb.now
            self.posed(self.kb.now, self._pose())

    def posed(self, time: float, position: Sequence[float]) -> None:
        """Write the robot's position (x, y, z) [m], unless it is not known (NaN)."""
        if all(map(isfinite, position)):
            self.rows.put(time, "pose", 0, [round(float(metres), 3) for metres in position])

    def acted(self, number: int, action: RequiredAction) -> None:
        """Write an action that has begun or ended."""
        shown = {"action": self.names["action", action.action], "cause": action.cause}
        self.put("action", number, shown | _ending(action))

    def adapted(self, adaptation: Adaptation) -> None:
        """Write an adaptation that is over, with the chain from cause to effect."""
        self._adapted += 1
        nodes = {} if self._tree is None else self._tree.about
        shown = {
            "t": adaptation.at_s,
            "kind": adaptation.kind,
            "cause": adaptation.trigger,
            "decided": adaptation.reason,
            "changed": adaptation.change,
            "reaction": adaptation.reaction_s,
            "in_force": plain(adaptation.in_force_s),
            "chain": chain_of(adaptation, tuple(self._events), self._task_plans, self.names, nodes),
        }
        self.put("adaptation", self._adapted, shown)
        if self._own is not None:
            self._own.adaptations.clear()  # the row is enough
        if self._what_if:
            self.suppose(self.kb.now)

    def suppose(self, time: float) -> None:
        """Work out and write what would be feasible if other values had been measured."""
        self._supposed += 1
        self.rows.put(
            time, "whatif", self._supposed, {"t": time, "cases": cases(self.kb, self.names)}
        )

    def trouble(self, words: str) -> None:
        """Write what went wrong, in a sentence."""
        self._troubles += 1
        self.put("problem", self._troubles, words)

    def elements_of(self, behaviour: Behaviour) -> list[int]:
        """Return the number of the action of a behaviour in a list, empty if it has none."""
        try:
            action = getattr(behaviour, "action", None)
        except Exception:  # py_trees raises several kinds if a port is not connected yet
            return []
        index = self.names.get(("action", action)) if isinstance(action, str) else None
        return [] if index is None else [index]


class _TreeRows(VisitorBase):
    """Writes the statuses of a tree after each tick, and the tree when it has changed."""

    def __init__(self, recorder: Recorder, tree: BehaviourTree) -> None:
        super().__init__(full=False)
        self._recorder = recorder
        self._behaviours = tree
        self._ids: dict[Behaviour, int] = {}
        self._known: dict[Behaviour, tuple[str, str]] = {}
        self._below: list[tuple[Behaviour, list[Behaviour]]] = []
        self._planning: list[Behaviour] = []
        self._ticked: dict[Behaviour, tuple[str, str]] = {}
        self._raised: set[Behaviour] = set()
        self._count = 0
        self._numbers = count()
        self.about: dict[int, list[int]] = {}
        self._describe()
        tree.add_visitor(self)

    def let_go(self) -> None:
        if self in self._behaviours.visitors:
            self._behaviours.visitors.remove(self)

    def initialise(self) -> None:
        self._ticked.clear()
        self._harmlessly(self._recorder.ticking)

    def run(self, behaviour: Behaviour) -> None:
        self._ticked[behaviour] = _LETTERS[behaviour.status], behaviour.feedback_message

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
            if behaviour not in self._raised:
                self._raised.add(behaviour)
                recorder.trouble(f"{behaviour.name}: {behaviour.feedback_message}")
        is_news = any(parent.children != children for parent, children in self._below)
        if is_news:
            self._describe()
        present = {
            behaviour: (_LETTERS[behaviour.status].lower(), behaviour.feedback_message)
            for behaviour in self._ids
        } | self._ticked
        for behaviour, uid in self._ids.items():
            if present[behaviour] != self._known.get(behaviour):
                self._known[behaviour] = present[behaviour]
                recorder.put("node", uid, list(present[behaviour]))
                is_news = True
        if is_news:
            recorder.put("tick", 0, self._count)
        self._count += 1
        recorder.ticked(self._planning)

    def _describe(self) -> None:
        recorder = self._recorder
        nodes = []
        parents: list[tuple[Behaviour, int | None]] = [(self._behaviours.root, None)]
        present: dict[Behaviour, int] = {}
        self._below = []
        self._planning = []
        self.about = {}
        while parents:
            behaviour, parent = parents.pop()
            if behaviour in present:
                continue
            uid = present[behaviour] = (
                self._ids[behaviour] if behaviour in self._ids else next(self._numbers)
            )
            parents += [(child, uid) for child in reversed(behaviour.children)]
            self._below.append((behaviour, list(behaviour.children)))
            if has_plans(behaviour):
                self._planning.append(behaviour)
            elements = recorder.elements_of(behaviour)
            for index in elements:
                self.about.setdefault(index, []).append(uid)
            nodes.append(
                [uid, parent, type(behaviour).__name__, behaviour.name, _shape(behaviour), elements]
            )
        for behaviour, uid in self._ids.items():
            if behaviour not in present:
                recorder.put("node", uid, None)
                self._known.pop(behaviour, None)
        self._ids = present
        recorder.put("tree", 0, {"name": self._behaviours.root.name, "nodes": nodes})


def _shape(behaviour: Behaviour) -> str:
    for kinds, shape in _SHAPES:
        if isinstance(behaviour, kinds):
            return shape
    if has_plans(behaviour):
        return "plan"
    return "other" if behaviour.children else "action"


def _ending(record: RequiredAction | ReconfigurationPlan) -> dict[str, Any]:
    return {
        "start": record.start,
        "end": record.end,
        "result": record.result,
        "reason": record.reason,
    }


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
        self._disturbed: set[tuple[float, str]] = set()
        is_ours = isinstance(run, RosaRun)
        kb = run.kb if is_ours else KnowledgeBase(run.model, clock=lambda: run.world.now)
        self._own = None if is_ours else kb
        self._sample = sample = run.ask("sample")
        self._measured = frozenset(kb.attributes)
        signals = dict(map(_split, sample.signals if sample else ()))
        header = {
            "title": run.mission.name,
            "mission": run.mission.name,
            "words": run.mission.summary,
            "task": run.task,
            "manager": run.manager,
            "seed": seed,
            "settings": dict(sorted(settings.items())),
            "signals": list(signals),
            "units": {name: unit for name, unit in signals.items() if unit},
        }
        tree = getattr(run, "tree", None)
        self.recorder = Recorder(kb, tree, keep=keep, what_if=what_if, header=header)
        self._show()
        run.listen(self)

    def end(self, verdict: Verdict) -> None:
        run = self._run
        self._show()
        figures = [
            list(figure_in_words(name, value, run.model)) for name, value in run.results().items()
        ]
        shown = {
            "outcome": verdict.outcome,
            "success": verdict.success,
            "reason": verdict.reason,
            "figures": figures,
        }
        self.recorder.put("result", 0, shown)
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
                if _split(signal)[0] not in self._measured:
                    recorder.put("signal", signal, round(value, 4))
        scenery = run.ask("scenery")
        if tuple(scenery) != self._scene:  # names alone tell that it has changed
            self._scene = tuple(scenery)
            recorder.show(scenery)
        for time, text in run.disturbances():
            if (time, text) not in self._disturbed:
                self._disturbed.add((time, text))
                number = len(self._disturbed)
                recorder.put("disturbance", number, {"t": time, "words": text})
        if self._own is not None:
            for number, action in enumerate(run.actions, start=1):
                recorder.acted(number, action)


def _split(signal: str) -> tuple[str, str]:
    """Return the attribute and the unit in a signal's name, e.g. "water visibility [m]"."""
    name, _, unit = signal.partition(" [")
    unit = unit.rstrip("]")
    return name.replace(" ", "_"), "" if unit == "-" else unit
