"""A second way to explore, without any cleverness.

Every situation is reached anew, from the beginning, in new objects.

Nothing is written back, no result is kept for another situation, no status is left out, and every
component fails for itself. Random small missions are explored in both ways.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
from proof_mutants import Act, Work, guarded
from py_trees.common import Status
from py_trees.composites import Selector, Sequence
from py_trees.decorators import Inverter, SuccessIsFailure

from kb import Model
from missions.proof.exploration import Exploration
from missions.proof.properties import check
from missions.proof.rig import Rig
from missions.proof.setup import Setup
from rosa_bt import ForAction, IsActionFeasible, do_until_unfeasible, feasible_then_act
from rosa_bt.decorators import UntilSuccess


def random_setup(seed):
    """Return a small random mission with any tree of a few nodes."""

    def model():
        rng = np.random.default_rng(seed)
        model = Model("random")
        level = model.quality_attribute("level", low=0.0, high=1.0)
        count = rng.integers(2, 4)
        parts = [model.component(f"part_{number}", kind="lifecycle") for number in range(count)]
        if rng.random() < 0.5:
            parts[0].configuration("fine", {"step": 1.0}, priority=1, constraints=[level >= 0.5])
            parts[0].configuration("coarse", {"step": 2.0}, priority=2)
        work = model.function("work", always_improve=bool(rng.random() < 0.5))
        work.design("first", parts[:1], priority=1)
        work.design("second", parts[1:], priority=2)
        model.action("do", requires=[work], constraints=[level >= 0.5])
        model.action("rest", requires=[work] if rng.random() < 0.3 else [])
        return model

    def build(kb, senses):
        rng = np.random.default_rng(seed + 1)

        def task(name):
            act = Act(name, kb, name)
            act.even_if_unfeasible = bool(rng.random() < 0.4)
            asks = IsActionFeasible(f"{name}?", kb, name)
            ways = {
                0: lambda: act,
                1: lambda: ForAction(name, kb, name, Work(f"{name} it")),
                2: lambda: guarded(kb, asks, act, memory=bool(rng.random() < 0.5)),
                3: lambda: feasible_then_act(act),
            }
            return ways[int(rng.integers(4))]()

        do = task("do")
        rest = task("rest")
        memory = bool(rng.random() < 0.5)
        ways = {
            0: lambda: do_until_unfeasible(do, rest, memory=memory, name="mission"),
            1: lambda: Selector("mission", memory, [do, SuccessIsFailure("on", rest)]),
            2: lambda: Sequence("mission", memory, [rest, do]),
            3: lambda: Inverter("mission", Sequence("both", memory, [do, rest])),
            4: lambda: Selector("mission", memory, [rest, do]),
        }
        root = ways[int(rng.integers(5))]()
        return UntilSuccess("until done", root) if rng.random() < 0.5 else root

    return Setup(build, model, seconds=600.0)


def seen(rig):
    """Return what there is to see in a situation.

    Components that are alike are counted, not named.
    """
    kb = rig.kb
    parts = Counter()
    for name, part in kb.components.items():
        users = [design for design, view in kb.designs.items() if name in view.components]
        parts[name if part.configurations else str(users), str(part.status), part.is_active] += 1
    tables = (kb.actions, kb.functions, kb.designs, kb.configurations)
    statuses = tuple((name, str(view.status)) for table in tables for name, view in table.items())
    running = frozenset(node.name for node in rig.doing if node.status is Status.RUNNING)
    level = kb.attributes["level"].value
    return statuses, frozenset(parts.items()), rig.required, level, rig.root.status, running


def key(rig):
    """Return all that a situation is, as far as these behaviours remember anything."""
    nodes = [*rig.root.iterate()]
    current = [getattr(node, "current_child", None) for node in nodes]
    places = tuple(None if child is None else nodes.index(child) for child in current)
    return tuple(node.status for node in nodes), places, rig.read()


class Twin:
    """Explores by running each story from the beginning, up to a number of rounds."""

    def __init__(self, setup, rounds):
        self.setup = setup
        self.situations = set()
        self.faults = set()
        self.ticked = set()
        self.runs = 0
        rig = self.run(())
        self.situations.add(seen(rig))
        keys = {key(rig)}
        layer = [()]
        for _ in range(rounds):
            layer = [longer for story in layer for longer in self.onward(story, keys)]

    def run(self, story, script=()):
        """Return the rig after a story.

        In its last tick leaves begin as scripted and go on as they like.
        """
        self.runs += 1
        rig = Rig(self.setup)
        self.faults |= set(rig.begin())
        for change, answers in story:
            if change is not None:
                change.apply(rig.kb)
            self.faults |= set(rig.settle())
            rig.tick(script if answers is None else answers)
            self.faults |= set(rig.settle())
        self.ticked |= {node.name for node in rig.ticked}
        return rig

    def onward(self, story, keys):
        rig = self.run(story)
        if rig.root.status is Status.SUCCESS:
            return
        for change, _ in rig.environment.changes(rig.read()):
            scripts = [()]
            while scripts:
                rig = self.run((*story, (change, None)), scripts.pop())
                scripts += rig.others
                self.situations.add(seen(rig))
                if key(rig) not in keys:
                    keys.add(key(rig))
                    yield (*story, (change, rig.taken))


def agree(seed, rounds):
    """Explore a random mission both ways, assert that they agree; return the stories run."""
    setup = random_setup(seed)
    found = Exploration(setup).explore()
    twin = Twin(replace(setup, symmetric=False), rounds)
    assert not found.unexplored
    early = [each.state for each in found.situations if len(each.path) <= rounds]
    assert {seen(found.load(state)) for state in early} == twin.situations
    assert twin.ticked <= {node.name for node in found.rig.ticked}
    soon = {fault for fault, trail in found.faults.items() if len(trail) <= rounds}
    assert soon <= twin.faults <= set(found.faults)
    findings = {finding.name: finding for finding in check(found)}
    released = findings["every request is released once, when what does it ends"]
    is_kept = any(set(each[2]) != each[5] for each in twin.situations)
    assert is_kept is (released.holds is False and len(released.trail) <= rounds)
    done = any(each[4] is Status.SUCCESS for each in twin.situations)
    assert not done or findings["the goal is reached if all goes well"].holds
    return twin.runs
