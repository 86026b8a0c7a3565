"""Domains for the tests of task plans, with behaviours of steps that do what they are told."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_pddl import Planner, Problem, initial_state, load_domain

# Every kind of condition and effect: at start, over all and at end; quantified, conditional,
# negative; costs.
HOUSE = """(define (domain house)
  (:types action room robot)
  (:predicates (action_feasible ?a - action) (go_action ?a - action) (look_action ?a - action)
               (at ?r - robot ?x - room) (free ?r - robot) (lit ?x - room) (open ?x - room)
               (scanned ?x - room) (broken ?x - room) (sealed ?x - room) (mobile ?r - robot))
  (:functions (total-cost))
  (:durative-action move
    :parameters (?a - action ?name - robot ?from ?to - room)
    :duration (= ?duration 5)
    :condition (and (at start (at ?name ?from)) (at start (free ?name))
                    (over all (action_feasible ?a))
                    (at start (mobile ?name))
                    (at start (go_action ?a)) (over all (not (= ?from ?to))) (over all (open ?to))
                    (over all (not (sealed ?to))))
    :effect (and (at start (not (at ?name ?from))) (at start (not (free ?name)))
                 (at end (at ?name ?to)) (at end (free ?name)) (at end (increase (total-cost) 3))))
  (:durative-action scan
    :parameters (?a - action ?r - robot ?x - room)
    :duration (= ?duration 5)
    :condition (and (over all (at ?r ?x)) (over all (lit ?x)) (at end (not (broken ?x)))
                    (at start (free ?r))
                    (over all (action_feasible ?a)) (at start (look_action ?a)))
    :effect (and (at start (lit ?x)) (at end (scanned ?x)) (at end (not (lit ?x)))
                 (at end (increase (total-cost) 1))))
  (:action clean
    :parameters (?r - robot)
    :precondition (exists (?x - room) (and (at ?r ?x) (broken ?x)))
    :effect (and (forall (?x - room) (when (at ?r ?x) (not (broken ?x))))
                 (increase (total-cost) 1)))
)
"""
SCAN_ALL = """(define (problem scan-all) (:domain house)
  (:objects go look - action kitchen hall attic - room robby rita - robot)
  (:init (mobile robby) (at rita attic) (free rita)
         (go_action go) (look_action look) (at robby hall) (free robby) (broken kitchen)
         (= (total-cost) 0)
         (open kitchen) (open hall) (open attic))
  (:goal (and {goal}))
  (:metric minimize (total-cost)))
"""
GOALS = (
    "(scanned hall)",
    "(scanned kitchen)",
    "(forall (?x - room) (scanned ?x))",
    "(not (broken kitchen)) (at robby attic)",
)


@cache
def house(goal):
    """Return the domain with a goal, and the best plan for it."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "domain.pddl").write_text(HOUSE)
        (Path(folder) / "problem.pddl").write_text(SCAN_ALL.format(goal=goal))
        domain = load_domain(Path(folder) / "domain.pddl", Path(folder) / "problem.pddl")
    state = initial_state(domain) | {domain.feasible_atom(action) for action in domain.rosa_actions}
    result = Planner().plan(Problem(domain, state))
    assert result.outcome.is_solved, result
    return domain, result.steps, state


class House:
    """A knowledge base, percepts, and a log of what steps begin and how they end."""

    def __init__(self, script=(), disturbances=()):
        """Take for each step how many ticks it takes and how it ends.

        And what happens at which tick.
        """
        model = Model("house")
        for action in ("go", "look"):
            model.action(action)
        self.kb = KnowledgeBase(model, clock=lambda: 0.0)
        self.script = list(script)
        self.disturbances = list(disturbances)
        self.facts = {}
        self.log = []
        self.tick = 0

    def behaviours(self, domain):
        return dict.fromkeys(domain.schemas, lambda step: Task(step, self))

    def disturb(self):
        """Let happen what happens at this tick."""
        for tick, what, value in self.disturbances:
            if tick != self.tick:
                continue
            if what in ("go", "look"):
                self.kb.assert_status(self.kb.actions[what], "feasible" if value else "unfeasible")
            else:
                self.facts[what] = value

    def next_task(self):
        begun = sum(what == "begins" for _, _, what in self.log)
        return self.script[begun] if begun < len(self.script) else (1, Status.SUCCESS)


class Task(Behaviour):
    """Takes as many ticks as the script says, and ends like that."""

    def __init__(self, step, world):
        super().__init__(str(step))
        self.step = step
        self.world = world

    def initialise(self):
        self.left, self.end = self.world.next_task()
        self.world.log.append((self.world.tick, self.step, "begins"))

    def update(self):
        self.left -= 1
        return Status.RUNNING if self.left > 0 else self.end

    def terminate(self, new_status):
        if self.world.log and self.world.log[-1][1:] == (self.step, "begins"):
            self.world.log.append((self.world.tick, self.step, new_status.value))
