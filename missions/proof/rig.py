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
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.visitors import VisitorBase

from kb import ConfigurationManager, KnowledgeBase, UnknownName
from missions.engine.components import VERBS
from missions.engine.mission import Condition
from missions.proof.setup import Environment, Fact, Facts, Leaf, Senses, Setup, without_debouncing
from missions.testing.scripted import LETTERS, FakeClock, replace_work
from rosa_bt import ForAction, RosaAction, TreeRunner
from rosa_bt.behaviours import KbBehaviour
from rosa_bt.composites import DoUntilUnfeasible
from rosa_bt.decorators import Delay, Timed

Answer = tuple[str, str]
"""The name of a leaf or time-out, and the letter of what it returned: R, S or F."""
_MOST_TURNS: Final = 20
"""After this many turns in a row, the manager is said not to come to rest."""
_OBEDIENT: Any = SimpleNamespace(**dict.fromkeys(VERBS, lambda *command: None))
"""A managed system that obeys at once."""


class Step(NamedTuple):
    """A round: what changes before the tick, and the answers of leaves in it."""

    change: Fact | None = None
    answers: tuple[Answer, ...] = ()

    def __str__(self) -> str:
        answers = ", ".join(f"{name} {LETTERS[letter].name}" for name, letter in self.answers)
        return f"{self.change or 'nothing happens'}; {answers or 'no leaf is asked'}"


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
        self.clock = FakeClock()
        self.setup = setup
        self.kb = KnowledgeBase(without_debouncing(setup.model()), clock=self.clock)
        self._manager = ConfigurationManager(self.kb, _OBEDIENT, planner=setup.planner())
        Blackboard.storage.clear()  # the whole process shares it
        self.senses = Senses()
        self.root = setup.build(self.kb, self.senses)
        self.nodes = list(self.root.iterate())
        self.doing = acting(self.nodes)
        leaves = [node for node in self.nodes if not node.children]
        self.environment = Environment(self.kb, leaves, setup)
        self.runner = TreeRunner(self.root, clock=self.clock)
        self.runner.tree.add_visitor(self)
        self.letters: dict[str, str] = {}
        self.ticked: set[Behaviour] = set()
        self.requesting: list[Behaviour] = []
        self.deeds: frozenset[str] = frozenset()
        self._asked: frozenset[str] = frozenset()
        names = dict.fromkeys(leaf.name for leaf in leaves)
        for name in setup.leaves:
            if name not in names:
                raise UnknownName("leaf", name, names)
        for leaf in leaves:
            says = setup.leaves.get(leaf.name) or self._usual(leaf)
            if says.answers:
                self._take_over(leaf, says)
        for node in self.nodes:
            if isinstance(node, Timed):
                self.letters[node.name] = "RS"
                vars(node)["is_over"] = partial(self._is_over, node)

    def run(self, behaviour: Behaviour) -> None:
        self.ticked.add(behaviour)

    # the answers of leaves

    def _take_over(self, leaf: Behaviour, says: Leaf) -> None:
        """Replace the work of a leaf by free answers; actions are still requested."""
        self.letters[leaf.name] = says.answers
        if isinstance(leaf, Condition) and not says.after:
            says = replace(says, after=self.setup.causes(leaf, self.kb, self.senses))
        self._asked |= {*says.after}
        kind = type(leaf)
        methods = (kind.update, kind.initialise, kind.terminate)
        if any("request_action" in method.__code__.co_names for method in methods):
            self.requesting.append(leaf)
            vars(leaf)["update"] = partial(self._answer, leaf, says, leaf.update)
        else:
            replace_work(leaf, partial(self._answer, leaf, says))

    def _usual(self, leaf: Behaviour) -> Leaf:
        """Return what an undeclared leaf may return.

        On success, what it makes feasible becomes so.
        """
        if isinstance(leaf, RosaAction):
            best = self.environment.best
            met = {name: best[name] for name in best if name in self._restored(leaf.action)}
            return Leaf(effects={"S": met})
        if isinstance(leaf, Condition):
            return Leaf("FS")
        is_of_py_trees = type(leaf).__module__.startswith("py_trees.")
        is_known = is_of_py_trees or isinstance(leaf, KbBehaviour | Timed)
        return Leaf("" if is_known else "RSF")

    def _restored(self, action: str) -> set[str]:
        """Return the attributes that an action restores, as the model says."""
        return {element.name for element in self.kb.model.actions[action].restores}

    def _answer(
        self, leaf: Behaviour, says: Leaf, work: Callable[[], object] = lambda: None
    ) -> Status:
        work()  # for its requests; what it returns is one of the free answers
        letter = self._choose(leaf, says.answers)
        action = getattr(leaf, "action", "")
        is_able = not isinstance(leaf, RosaAction) or self.kb.is_feasible(action)
        is_early = says.after and self.deeds.isdisjoint(says.after)
        if letter == "S" and (is_early or not is_able):
            self.is_caused = False
        if letter != "F" and is_able and not isinstance(leaf, Condition):
            effects = self.setup.effects.get(action, frozenset[str]())
            self.deeds |= self._asked.intersection({leaf.name, action, *effects})
            if letter == "S":
                self.deeds |= {f"{effect} done" for effect in self.setup.goal & effects}
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
            taken = self.taken
            if len(taken) < len(self._script):
                self.answers[leaf] = self._script[len(taken)]
            else:
                self.others += [(*taken, (leaf.name, other)) for other in letters[1:]]
                self.answers[leaf] = (leaf.name, letters[0])
        return self.answers[leaf][1]

    @property
    def taken(self) -> tuple[Answer, ...]:
        """The answers in the last tick, in order."""
        return tuple(self.answers.values())

    def _is_over(self, node: Behaviour, *_: float) -> bool:
        """Let the time of a decorator be over by now, or not.

        A child that a delay has begun goes on.
        """
        has_begun = isinstance(node, Delay) and node.children[0].status is Status.RUNNING
        return has_begun or self._choose(node, "RS") == "S"

    # rounds

    def begin(self) -> list[str]:
        """Measure what is known at first and let the manager take its turns.

        Return its faults, in words.
        """
        for fact in self.environment.start:
            fact.apply(self.kb)
        return self.settle()

    def tick(self, script: tuple[Answer, ...]) -> None:
        """Tick the tree with these answers, then with the first ones possible."""
        self._script = script
        self.answers: dict[Behaviour, Answer] = {}
        self.others: list[tuple[Answer, ...]] = []
        self.is_caused = True
        self.runner.tick()
        instead = self._instead(self.root) if self.root.status is Status.SUCCESS else ""
        self.deeds |= {f"the success of {instead} ends the mission"} if instead else set()

    def settle(self) -> list[str]:
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
        return faults

    # facts

    def read(self) -> Facts:
        """Return all facts, with the value that stands for each measurement."""
        kb = self.kb
        facts = []
        for name in self.environment.best:
            view = kb.attributes[name]
            facts.append(Fact("attribute", name, None if view.is_stale else view.value))
        for name, part in kb.components.items():
            facts.append(Fact("component", name, part.status == "failure"))
            facts.append(Fact("activity", name, part.is_active))
        for each in (*kb.designs.values(), *kb.configurations.values()):
            facts.append(Fact(each.node.kind, each.name, each.is_selected))
        preferences = {each.action: str(each.preference or "") for each in kb.required_actions}
        facts += [Fact("action", name, preferences.get(name)) for name in kb.actions]
        return tuple(facts)

    def write(self, facts: Facts) -> None:
        """Bring about facts, by telling the knowledge base what differs."""
        for fact, present in zip(facts, self.read(), strict=True):
            if fact != present:
                fact.apply(self.kb)

    # what properties ask

    @property
    def required(self) -> tuple[str, ...]:
        """The actions that are requested."""
        return tuple(sorted(each.action for each in self.kb.required_actions))

    @property
    def running(self) -> set[str]:
        """The actions of the behaviours that run.

        Of leaves that request by themselves, all that are requested.
        """
        running = {node.action for node in self.doing if node.status is Status.RUNNING}
        if any(leaf.status is Status.RUNNING for leaf in self.requesting):
            running.update(self.required)
        return running

    def _instead(self, node: Behaviour) -> str:
        """Return the action whose success a node passes on in place of what it is for.

        Empty if there is none.
        """
        wanted = set[str]()
        for child in node.children[:1] if isinstance(node, DoUntilUnfeasible) else node.children:
            actions = [leaf.action for leaf in acting(child.iterate())]
            if child.status is Status.SUCCESS:
                if actions and all(self._serves(action, wanted) for action in actions):
                    return str(actions[-1])
                if action := self._instead(child):
                    return action
            if isinstance(node, Selector):
                wanted.update(actions)
        return ""

    def _serves(self, action: str, wanted: set[str]) -> bool:
        """Tell whether an action only makes others feasible.

        It restores what they need, or is free of a limit on the robot that they have.
        """
        actions = self.kb.actions
        limits = {limit.attribute for name in wanted for limit in actions[name].constraints}
        own = {limit.attribute for limit in actions[action].constraints}
        eased = (self.environment.qualities - own) | self._restored(action)
        return action not in wanted and not eased.isdisjoint(limits)


def acting(nodes: Iterable[Behaviour]) -> list[Any]:
    return [node for node in nodes if isinstance(node, RosaAction | ForAction)]
