"""An executor whose tick, or whose end, is interrupted at some instruction.

What must be true then and afterwards.
"""

import sys
from pathlib import Path

import py_trees
from pddl_world import World
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence

import rosa_pddl

TRACED = (str(Path(rosa_pddl.__file__).parent), str(Path(py_trees.__file__).parent / "behaviour"))


class Owner(Behaviour):
    """Owns something from its first tick to its end, as a request is owned."""

    def __init__(self, step, world):
        super().__init__(str(step))
        self.world = world
        self.left = 2

    def initialise(self):
        self.world.owned.add(self)

    def update(self):
        self.left -= 1
        return Status.RUNNING if self.left else Status.SUCCESS

    def terminate(self, new_status):
        self.world.owned.discard(self)


def nested(step, world):
    return Sequence(str(step), memory=True, children=[Owner(step, world), Owner(step, world)])


def world_of(domain, planner, **settings):
    world = World(domain, planner, task=nested, delay_s=0.0, **settings)
    world.owned = set()
    return world


def interrupted(act, instruction):
    """Do something, interrupted before one of its instructions, by number.

    Return how many there were till then.
    """
    seen = 0

    def each(frame, event, _):
        nonlocal seen
        if event == "opcode":
            seen += 1
            if seen == instruction:
                raise KeyboardInterrupt
        return each

    def entered(frame, *_):
        if not frame.f_code.co_filename.startswith(TRACED):
            return None
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        return each

    before = sys.gettrace()
    sys.settrace(entered)
    try:
        act()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    return seen


def instructions(make, ticks, act):
    """Return how many instructions there are to interrupt in what is done after so many ticks."""
    world = prepared(make, ticks)
    return interrupted(lambda: act(world), -1)


def prepared(make, ticks):
    world = make()
    for _ in range(ticks):
        if world.tick() is not Status.RUNNING:
            break
    return world


def tick(world):
    world.root.tick_once()


def stop(world):
    world.root.stop(Status.INVALID)


def check(make, ticks, act, instruction):
    """Interrupt, and see that what was begun is released, by going on as by an end, and that the goal is reached."""
    world = prepared(make, ticks)
    interrupted(lambda: act(world), instruction)
    children = {node for child in world.executor.children for node in child.iterate()}
    assert all(owner in children for owner in world.owned), "owned by nobody who could release it"
    stop(world)
    assert not world.owned
    assert world.executor.current_steps == ()
    assert world.executor.children == []
    world = prepared(make, ticks)
    interrupted(lambda: act(world), instruction)
    assert world.run() is Status.SUCCESS
    assert not world.owned
    stop(world)
    assert not world.owned
