"""The parts of a mission that is explored, in one situation.

Knowledge base, manager, and tree with free answers.

The composites, the decorators and the leaves that ask the knowledge base are the real ones, and so
is the manager.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.behaviours import ProbabilisticBehaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.decorators import Timeout
from py_trees.timers import Timer
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, KnowledgeBase, UnknownName
from kb.elements import AttributeKind
from missions.engine.components import VERBS
from missions.engine.mission import Condition
from missions.proof.setup import (
    Change,
    Environment,
    Facts,
    Leaf,
    Senses,
    Setup,
    without_debouncing,
)
from missions.testing.scripted import LETTERS, replace_work
from rosa_bt import ForAction, RosaAction, TreeRunner
from rosa_bt.behaviours import KbBehaviour
from rosa_bt.composites import DoUntilUnfeasible

Answer = tuple[str, str]
"""The name of a leaf or time-out, and the letter of what it returned: R, S or F."""
_MOST_TURNS: Final = 20
"""After this many turns in a row, the manager is said not to come to rest."""
_OBEDIENT: Any = SimpleNamespace(**dict.fromkeys(VERBS, lambda *command: None))
"""A managed system that obeys at once."""


class Step(NamedTuple):
    """A round: what changes before the tick, and the answers of leaves in it."""

    changes: tuple[Change, ...] = ()
    answers: tuple[Answer, ...] = ()

    def __str__(self) -> str:
        happens = "; ".join(map(str, self.changes)) or "nothing happens"
        answers = ", ".join(f"{name} {LETTERS[letter].name}" for name, letter in self.answers)
        return f"{happens}; {answers or 'no leaf is asked'}"


class Rig(VisitorBase):
    """The parts of a mission in one situation; predicates of users are called with it.

    Attributes:
        kb: the knowledge base.
        root: of the tree.
        letters: by name, what leaves and time-outs may answer.
        others: scripts for the answers that were possible in the last tick but not taken, each
            once.
        answers: what leaves answered in the last tick.
        ticked: the behaviours that were ever ticked.
        is_caused: whether, in the last tick, nothing succeeded before the deed that brings it
            about.
        deeds: what was brought about or is under way, as far as conditions and the goal ask for it.
        requesting: the leaves that request actions by themselves.
        senses: the percepts; those that a leaf declares to bring about (`brings`) hold after it.

    Raises:
        UnknownName: a declaration names a leaf that the tree does not have.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__(full=False)
        self.clock = 0.0
        self.setup = setup
        self.kb = KnowledgeBase(without_debouncing(setup.model()), clock=lambda: self.clock)
        self._manager = ConfigurationManager(self.kb, _OBEDIENT, planner=setup.planner())
        self.answers: dict[Behaviour, str] = {}
        self.others: list[tuple[Answer, ...]] = []
        self._script: tuple[Answer, ...] = ()
        Blackboard.storage.clear()  # the whole process shares it
        self.senses = senses = Senses()
        self.root = setup.build(self.kb, senses)
        self.nodes = list(self.root.iterate())
        self.doing = acting(self.nodes)
        leaves = [node for node in self.nodes if not node.children]
        self.environment = Environment(self.kb, leaves, setup)
        self.runner = TreeRunner(self.root, clock=lambda: self.clock)
        self.runner.tree.add_visitor(self)
        self.letters: dict[str, str] = {}
        self.ticked: set[Behaviour] = set()
        self.requesting: list[Behaviour] = []
        self.deeds: frozenset[str] = frozenset()
        self.is_caused = True
        self._asked: frozenset[str] = frozenset()
        names = dict.fromkeys(leaf.name for leaf in leaves)
        for name in setup.leaves:
            if name not in names:
                raise UnknownName("leaf", name, names)
        for leaf in leaves:
            self._take_over(leaf, setup.leaves.get(leaf.name) or self._usual(leaf), senses)
        for node in self.nodes:
            if isinstance(node, Timeout):
                vars(node).update(update=partial(self._time_out, node), initialise=lambda: None)
            elif not node.children or not callable(getattr(node, "is_over", None)):
                continue
            self.letters[node.name] = "RS"
            vars(node)["is_over"] = partial(self._is_over, node)
        self._facts: tuple[int, Facts] | None = None

    def run(self, behaviour: Behaviour) -> None:
        self.ticked.add(behaviour)

    # the answers of leaves

    def _take_over(self, leaf: Behaviour, says: Leaf, senses: Senses) -> None:
        """Replace the work of a leaf by free answers; actions are still requested."""
        if not says.answers:
            return
        self.letters[leaf.name] = says.answers
        if isinstance(leaf, Condition) and not says.after:
            says = replace(says, after=self.setup.causes.needed(leaf, self.kb, senses))
        self._asked |= {*says.after}
        if _requests(leaf):
            self.requesting.append(leaf)
            vars(leaf)["update"] = partial(self._answer, leaf, says, leaf.update)
        else:
            replace_work(leaf, partial(self._answer, leaf, says, None))

    def _usual(self, leaf: Behaviour) -> Leaf:
        """Return what an undeclared leaf may return.

        On success, what it makes feasible becomes so.
        """
        if isinstance(leaf, Timer):
            return Leaf("RS")
        is_of_py_trees = type(leaf).__module__.startswith("py_trees.")
        if is_of_py_trees and not isinstance(leaf, ProbabilisticBehaviour):
            return Leaf("")
        if isinstance(leaf, KbBehaviour) and not isinstance(leaf, RosaAction):
            return Leaf("")
        if isinstance(leaf, Condition):
            return Leaf("FS")
        if not isinstance(leaf, RosaAction):
            return Leaf()
        met = {name: self.environment.best(name) for name in self._restored(leaf.action)}
        return Leaf(effects={"S": met} if met else {})

    def _restored(self, action: str) -> set[str]:
        """Return the attributes that change which an action restores, as the model says."""
        restores = self.kb.model.actions[action].restores
        return {element.name for element in restores} & self.environment.values.keys()

    def _answer(self, leaf: Behaviour, says: Leaf, own: Callable[[], object] | None) -> Status:
        if own is not None:
            own()  # for its requests; what it returns is one of the free answers
        letter = self._choose(leaf, says.answers)
        action = getattr(leaf, "action", "")
        is_able = not isinstance(leaf, RosaAction) or self.kb.is_feasible(action)
        is_early = says.after and self.deeds.isdisjoint(says.after)
        if letter == "S" and (is_early or not is_able):
            self.is_caused = False
        if letter != "F" and is_able and not isinstance(leaf, Condition):
            effects = self.setup.causes.effects.get(action, set[str]())
            self.deeds |= self._asked.intersection({leaf.name, action, *effects})
            if letter == "S":
                goal = self.setup.causes.goal.intersection(effects)
                self.deeds |= {f"{effect} done" for effect in goal}
        if letter == "S" and hasattr(leaf, "brings"):
            self.senses.holding = leaf.brings()
        for attribute, value in says.effects.get(letter, {}).items():
            self.kb.measure(attribute, value)
        return LETTERS[letter]

    def _choose(self, leaf: Behaviour, letters: str) -> str:
        """Return the answer of a leaf by the script, or else the first letter.

        Asked again, it says the same.
        """
        if leaf not in self.answers:
            place = len(self.answers)
            if place < len(self._script):
                self.answers[leaf] = self._script[place][1]
            else:
                taken = self.taken
                self.others += [(*taken, (leaf.name, other)) for other in letters[1:]]
                self.answers[leaf] = letters[0]
        return self.answers[leaf]

    @property
    def taken(self) -> tuple[Answer, ...]:
        """The answers in the last tick, in order."""
        return tuple((leaf.name, letter) for leaf, letter in self.answers.items())

    def _is_over(self, node: Behaviour, *_: float) -> bool:
        """Let the time of a decorator be over by now, or not.

        A child that a delay has begun goes on.
        """
        has_begun = node.children[0].status is Status.RUNNING and type(node).__name__ == "Delay"
        return has_begun or self._choose(node, "RS") == "S"

    def _time_out(self, node: Timeout) -> Status:
        if node.decorated.status is Status.RUNNING and self._is_over(node):
            node.decorated.stop(Status.INVALID)
            return Status.FAILURE
        return node.decorated.status

    # rounds

    def begin(self) -> tuple[str, ...]:
        """Measure the start values and let the manager take its turns.

        Return its faults, in words.
        """
        for name, value in self.setup.start.items():
            self.kb.measure(name, value)
        environment = self.environment
        for name, values in environment.values.items():
            best = environment.best(name)
            is_new = self.measured(name) is None and name not in environment.read
            if is_new and not values[best]:
                self.kb.measure(name, best)  # as good as no measurement
        return self.settle()

    def tick(self, script: tuple[Answer, ...]) -> None:
        """Tick the tree with these answers, then with the first ones possible."""
        self._script = script
        self.answers = {}
        self.others = []
        self.is_caused = True
        self.runner.tick()
        instead = self._instead(self.root) if self.root.status is Status.SUCCESS else ""
        self.deeds |= {f"the success of {instead} ends the mission"} if instead else set()

    def settle(self) -> tuple[str, ...]:
        """Let the manager take its turns until it has nothing to do.

        Return its faults, in words.
        """
        kb = self.kb
        faults = []
        try:
            for _ in range(_MOST_TURNS):
                revision = kb.revision
                if self._manager.update() is None and kb.revision == revision:
                    break
            else:
                faults.append("the manager does not come to rest")
        except Exception as error:
            faults.append(f"the manager raised {type(error).__name__}: {error}")
        if kb.pending_plan is not None:
            faults.append(f"the plan {kb.pending_plan} does not end")
        for action in self.required:
            if kb.actions[action].status not in ("unfeasible", "solved"):
                faults.append(f"the manager does not configure the robot for {action}")
        return tuple(faults)

    # facts

    def read(self) -> Facts:
        """Return all facts, with the value that stands for each measurement."""
        kb = self.kb
        if self._facts is not None and self._facts[0] == kb.revision:
            return self._facts[1]
        values = []
        for name in self.environment.values:
            view = kb.attributes[name]
            value = None if view.is_stale else view.value
            values.append((name, value))
        components = kb.components.items()
        selectable = [*kb.designs.values(), *kb.configurations.values()]
        requested = [(each.action, str(each.preference or "")) for each in kb.required_actions]
        facts = Facts(
            tuple(values),
            frozenset(name for name, view in components if view.status == "failure"),
            frozenset(name for name, view in components if view.is_active),
            frozenset((view.node.kind, view.name) for view in selectable if view.is_selected),
            tuple(sorted(requested)),
        )
        self._facts = kb.revision, facts
        return facts

    def write(self, facts: Facts) -> None:
        """Bring about facts, by telling the knowledge base what differs."""
        kb = self.kb
        present = self.read()
        if facts == present:
            return
        for action in {action for action, _ in {*present.requested} - {*facts.requested}}:
            kb.cancel_action(action)
        for name in present.failed ^ facts.failed:
            Change(name, name in facts.failed).apply(kb)
        for name, value in {*facts.values} - {*present.values}:
            Change(name, value).apply(kb)
        for name in present.active ^ facts.active:
            kb.component_active(name, name in facts.active)
        tables: dict[str, Any] = {"function design": kb.designs, "configuration": kb.configurations}
        for kind, name in present.selected ^ facts.selected:
            kb.assert_selected(tables[kind][name], (kind, name) in facts.selected)
        for action, preference in {*facts.requested} - {*present.requested}:
            kb.assert_status(kb.actions[action], "feasible")  # it may have been requested earlier
            kb.request_action(action, preference or None)
            kb.retract_status(kb.actions[action])
        self._facts = kb.revision, facts

    # what properties ask

    def is_required(self, action: str) -> bool:
        """Return whether an action is requested."""
        return action in self.required

    def measured(self, attribute: str) -> float | None:
        """Return the latest measurement of an attribute; None if there is none."""
        return self.kb.attributes[attribute].value

    @property
    def required(self) -> tuple[str, ...]:
        """The actions that are requested."""
        return tuple(sorted(each.action for each in self.kb.required_actions))

    @property
    def unfeasible(self) -> tuple[str, ...]:
        """The actions that are requested although they are unfeasible."""
        return tuple(action for action in self.required if not self.kb.is_feasible(action))

    @property
    def running(self) -> frozenset[str]:
        """The actions of the behaviours that run.

        Of leaves that request by themselves, all that are requested.
        """
        running = {node.action for node in self.doing if node.status is Status.RUNNING}
        if any(leaf.status is Status.RUNNING for leaf in self.requesting):
            running |= set(self.required)
        return frozenset(running)

    def is_quality(self, attribute: str) -> bool:
        """Return whether an attribute is of the robot, not of its surroundings."""
        return self.kb.model.attributes[attribute].kind is AttributeKind.QUALITY

    def is_kept(self, name: str) -> bool:
        """Return whether only the robot changes it: a component, or a quality without a rate."""
        if name in self.kb.components:
            return True
        rates = self.kb.model.attributes[name].rates
        return self.is_quality(name) and all(rate.while_ for rate in rates)

    def _instead(self, node: Behaviour) -> str:
        """Return the action whose success a node passes on in place of what it is for.

        Empty if there is none.
        """
        children = node.children[:1] if isinstance(node, DoUntilUnfeasible) else node.children
        for place, child in enumerate(children):
            if child.status is Status.SUCCESS:
                leaves = acting(child.iterate())
                before = children[:place] if isinstance(node, Selector) else []
                wanted = {leaf.action for each in before for leaf in acting(each.iterate())}
                if leaves and all(self._serves(leaf.action, wanted) for leaf in leaves):
                    return str(leaves[-1].action)
                if action := self._instead(child):
                    return action
        return ""

    def _serves(self, action: str, wanted: set[str]) -> bool:
        """Tell whether an action only makes others feasible.

        It is free of a limit on the robot that they have.
        """
        actions = self.kb.actions
        limits = {limit.attribute for name in wanted for limit in actions[name].constraints}
        own = {limit.attribute for limit in actions[action].constraints}
        is_freer = any(self.is_quality(name) for name in limits - own)
        return action not in wanted and (is_freer or bool(self._restored(action) & limits))


def acting(nodes: Iterable[Behaviour]) -> list[Any]:
    return [node for node in nodes if isinstance(node, RosaAction | ForAction)]


def _requests(leaf: Behaviour) -> bool:
    """Tell whether the work of a leaf requests actions by itself."""
    kind = type(leaf)
    methods = (kind.update, kind.initialise, kind.terminate)
    return any("request_action" in method.__code__.co_names for method in methods)
