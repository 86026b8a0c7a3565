"""A small world for the tests of rosa_pddl: its time, its facts, a knowledge base and behaviours of steps."""

from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl import PlanExecutor, Planner, load_domain

MISSIONS = Path(__file__).parents[2] / "missions"

# Every effect and condition that the sequential reading of durative actions has to get right.
ROOMS_DOMAIN = """(define (domain rooms)
  (:types action room robot)
  (:predicates (action_feasible ?a - action) (go_action ?a - action) (look_action ?a - action)
               (at ?r - robot ?x - room) (free ?r - robot) (lit ?x - room)
               (scanned ?x - room) (broken ?x - room))
  (:durative-action move
    :parameters (?a - action ?r - robot ?from ?to - room)
    :duration (= ?duration 5)
    :condition (and (at start (at ?r ?from)) (at start (free ?r)) (over all (action_feasible ?a))
                    (at start (go_action ?a)) (over all (not (= ?from ?to))))
    :effect (and (at start (not (at ?r ?from))) (at start (not (free ?r))) (at end (at ?r ?to)) (at end (free ?r))))
  (:durative-action scan
    :parameters (?a - action ?r - robot ?x - room)
    :duration (= ?duration 5)
    :condition (and (over all (at ?r ?x)) (over all (lit ?x)) (at end (not (broken ?x))) (at start (free ?r))
                    (over all (action_feasible ?a)) (at start (look_action ?a)))
    :effect (and (at start (lit ?x)) (at end (scanned ?x)) (at end (not (lit ?x)))))
  (:action clean
    :parameters (?r - robot)
    :precondition (exists (?x - room) (and (at ?r ?x) (broken ?x)))
    :effect (and (forall (?x - room) (when (at ?r ?x) (not (broken ?x)))))))
"""
ROOMS_PROBLEM = """(define (problem scan-all) (:domain rooms)
  (:objects go look - action kitchen hall - room robby - robot)
  (:init (go_action go) (look_action look) (at robby hall) (free robby) (broken kitchen))
  (:goal (forall (?x - room) (scanned ?x))))
"""


def load_mission(name):
    return load_domain(MISSIONS / name / "domain.pddl", MISSIONS / name / "problem.pddl")


def load_text(folder, domain, problem):
    (folder / "domain.pddl").write_text(domain)
    (folder / "problem.pddl").write_text(problem)
    return load_domain(folder / "domain.pddl", folder / "problem.pddl")


@contextmanager
def as_global(environment):
    """The validators of unified-planning 1.3 work in the global environment, whatever they are given."""
    import unified_planning.environment as module

    before = module.GLOBAL_ENVIRONMENT
    module.GLOBAL_ENVIRONMENT = environment
    try:
        yield
    finally:
        module.GLOBAL_ENVIRONMENT = before


class FakeKb:
    def __init__(self, actions):
        self.actions: Mapping[str, object] = dict.fromkeys(actions, "")
        self.unfeasible = set()

    def is_feasible(self, action):
        self.actions[action]  # an unknown name raises
        return action not in self.unfeasible


class Task(Behaviour):
    """Succeeds on its last tick; the world notes when it begins and how it ends."""

    def __init__(self, step, world):
        super().__init__(str(step))
        self.step = step
        self.world = world

    def initialise(self):
        self.left = self.world.ticks.get(self.step.schema, 3)
        self.world.log.append((self.world.now_s, self.step.schema, "begins"))

    def update(self):
        self.left -= 1
        event = self.world.events.pop(self.step.schema, None) if self.left <= 0 else None
        if isinstance(event, Exception):
            self.left = 1
            raise event
        return event or (Status.SUCCESS if self.left <= 0 else Status.RUNNING)

    def terminate(self, new_status):
        self.world.log.append((self.world.now_s, self.step.schema, new_status.value))


class World:
    """Ticks a plan executor in lock-step: 0.1 s a tick, the planner caught up with between ticks."""

    def __init__(self, domain, planner=None, kb=None, task=Task, **settings):
        self.tick_number = 0  # a knowledge base asks the clock when it is made
        self.domain = domain
        self.kb = FakeKb(domain.rosa_actions) if kb is None else kb(self)
        self.facts: dict[str, bool] = {}
        self.ticks: dict[str, int] = {}
        self.events: dict[str, object] = {}
        self.log: list[tuple[float, str, str]] = []
        self.executor = PlanExecutor(
            "plan",
            kb=self.kb,
            domain=domain,
            behaviours={schema: lambda step: task(step, self) for schema in domain.schemas},
            sense=lambda: self.facts,
            clock=lambda: self.now_s,
            planner=planner or Planner(),
            **settings,
        )
        self.root = self.executor

    @property
    def now_s(self):
        return round(self.tick_number * 0.1, 3)

    def tick(self):
        self.executor.catch_up()
        self.root.tick_once()
        self.tick_number += 1
        return self.root.status

    def run(self, until=None, limit=200):
        """Tick until a schema runs, or until the end; returns the last status."""
        for _ in range(limit):
            status = self.tick()
            step = next(iter(self.executor.current_steps), None)
            if status is not Status.RUNNING or (step is not None and step.schema == until):
                return status
        raise AssertionError(f"neither ended nor reached {until} in {limit} ticks: {self.log}")

    def plans(self):
        return [[step.schema for step in record.steps] for record in self.executor.plans]
