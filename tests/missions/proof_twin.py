"""A second way to explore, without any cleverness: every situation is reached anew, from the beginning, in new objects.

Nothing is written back, no result is kept for another situation, no status is left out, and every component fails for
itself. Random small missions are explored in both ways.
"""

from collections import Counter

import numpy as np
from proof_mutants import Act, Work, guarded
from py_trees.common import Status
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Inverter, SuccessIsFailure

from kb import Model
from missions.proof.exploration import Exploration
from missions.proof.properties import check
from missions.proof.rig import Rig, Setup
from rosa_bt import ForAction, IsActionFeasible, do_until_unfeasible, feasible_then_act
from rosa_bt.decorators import UntilSuccess

FEW = {"failing": ("part_0", "part_1")}


def random_setup(seed: int) -> Setup:
    """Return a small mission: two actions, up to three components, one attribute, and any tree of a few nodes."""

    def model():
        rng = np.random.default_rng(seed)
        made = Model("random")
        level = made.quality_attribute("level", low=0.0, high=1.0)
        parts = [
            made.component(f"part_{number}", kind="lifecycle")
            for number in range(rng.integers(2, 4))
        ]
        if rng.random() < 0.5:
            parts[0].configuration("fine", {"step": 1.0}, priority=1, constraints=[level >= 0.5])
            parts[0].configuration("coarse", {"step": 2.0}, priority=2)
        work = made.function("work", always_improve=bool(rng.random() < 0.5))
        work.design("first", parts[:1], priority=1)
        if len(parts) > 1:
            work.design("second", parts[1:], priority=2)
        made.action("do", requires=[work], constraints=[level >= 0.5])
        made.action("rest", requires=[work] if rng.random() < 0.3 else [])
        return made

    def build(kb, senses):
        rng = np.random.default_rng(seed + 1)

        def task(name):
            kind, rough = rng.integers(4), bool(rng.random() < 0.4)
            act = Act(name, kb, name, even_if_unfeasible=rough)
            if kind == 0:
                return act
            if kind == 1:
                return ForAction(name, kb, name, Work(f"{name} it"))
            if kind == 2:
                return guarded(
                    kb, IsActionFeasible(f"{name}?", kb, name), act, memory=bool(rng.random() < 0.5)
                )
            return feasible_then_act(act)

        do, rest, memory = task("do"), task("rest"), bool(rng.random() < 0.5)
        kind = rng.integers(5)
        if kind == 0:
            root = do_until_unfeasible(do, rest, memory=memory, name="mission")
        elif kind == 1:
            root = Selector("mission", memory=memory, children=[do, SuccessIsFailure("on", rest)])
        elif kind == 2:
            root = Sequence("mission", memory=memory, children=[rest, do])
        elif kind == 3:
            root = Inverter("mission", Sequence("both", memory=memory, children=[do, rest]))
        else:
            root = Selector("mission", memory=memory, children=[rest, do])
        return UntilSuccess("until done", root) if rng.random() < 0.5 else root

    return Setup(model, build, start={"level": 0.75}, slow=bool(seed % 10 == 0), environment=FEW)


def seen(rig: Rig):
    """Return what there is to see in a situation; components that are alike are counted, not named."""
    kb = rig.kb
    users = {
        name: [one for one, of in kb.designs.items() if name in of.components]
        for name in kb.components
    }
    alike = {
        name: name if one.configurations else str(users[name])
        for name, one in kb.components.items()
    }
    tables = (kb.actions, kb.functions, kb.designs, kb.configurations)
    return (
        tuple((name, str(one.status)) for table in tables for name, one in table.items()),
        frozenset(
            Counter(
                (alike[name], str(one.status), one.is_active) for name, one in kb.components.items()
            ).items()
        ),
        rig.required,
        kb.attributes["level"].value,
        rig.root.status,
        frozenset(one.name for one in rig.doing if one.status.name == "RUNNING"),
    )


class Twin:
    """Explores by running each story from the beginning, up to a number of rounds.

    Attributes:
        situations: what there was to see after each story.
        faults: of the manager.
        ticked: the names of the behaviours that were ticked.
        runs: how many stories were run.
    """

    def __init__(self, setup: Setup, rounds: int) -> None:
        self.setup = setup
        self.situations, self.faults, self.ticked, self.runs = set(), set(), set(), 0
        rig = self._run(())
        self.situations.add(seen(rig))
        keys, layer = {key(rig)}, [()]
        for _ in range(rounds):
            layer = [
                longer for story in layer for longer, is_new in self._onward(story, keys) if is_new
            ]

    def _run(self, story, script=()):
        """Return the rig after a story; in its last tick leaves begin as scripted and go on as they like."""
        self.runs += 1
        rig = Rig(self.setup)
        self.faults |= set(rig.begin())
        for changes, answers, late in story:
            for change in changes:
                change.apply(rig.kb)
            self.faults |= set(() if late[0] else rig.settle())
            rig.tick(script if answers is None else answers)
            self.faults |= set(() if late[1] else rig.settle())
        self.ticked |= {one.name for one in rig.ticked}
        return rig

    def _onward(self, story, keys):
        rig = self._run(story)
        if rig.root.status is Status.SUCCESS:
            return
        missed = (False, True) if self.setup.slow else (False,)
        for changes in list(rig.environment.changes(rig.read())):
            for late in [(before, after) for before in missed for after in missed]:
                scripts = [()]
                while scripts:
                    rig = self._run((*story, (changes, None, late)), scripts.pop())
                    scripts += rig.choices.others
                    self.situations.add(seen(rig))
                    reached = key(rig)
                    yield (*story, (changes, tuple(rig.choices.taken), late)), reached not in keys
                    keys.add(reached)


def key(rig: Rig):
    """Return all that a situation is, as far as the behaviours of these missions remember anything."""
    places = [
        (one.status, None if one.current_child is None else one.children.index(one.current_child))
        for one in rig.root.iterate()
        if isinstance(one, Composite)
    ]
    leaves = [one.status for one in rig.root.iterate()]
    return tuple(places), tuple(leaves), rig.read()


def agree(seed: int, rounds: int = 3) -> int:
    """Explore a random mission both ways, assert that they agree, and return how many stories the twin has run."""
    setup = random_setup(seed)
    found = Exploration(setup).explore(seconds=600.0)
    every = Setup(
        setup.model,
        setup.build,
        start=setup.start,
        slow=setup.slow,
        environment={**FEW, "symmetric": False},
    )
    twin = Twin(every, rounds)
    assert found.is_finished
    early = [number for number in range(len(found.situations)) if len(found.path(number)) <= rounds]
    assert {seen(found.load(number)) for number in early} == twin.situations, seed
    assert twin.ticked <= {one.name for one in found.rig.ticked}, seed
    assert (
        {fault for fault, trail in found.faults.items() if len(trail) <= rounds}
        <= twin.faults
        <= set(found.faults)
    ), seed
    findings = {one.name: one for one in check(found)}
    released = findings["every request is released once, when what does it ends"]
    is_kept = any(set(one[2]) != one[5] for one in twin.situations)
    assert is_kept is (released.holds is False and len(released.trail) <= rounds), seed
    done = any(one[4] is Status.SUCCESS for one in twin.situations)
    assert not done or findings["the goal is reached if all goes well"].holds, seed
    return twin.runs
