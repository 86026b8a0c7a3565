"""Random worlds in which much goes wrong for a while, and a twin that says by brute force what can be reached then."""

from collections import Counter
from concurrent.futures import Future

from numpy.random import default_rng
from pddl_world import World
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_pddl import Outcome, Planner, PlanningResult, ReplanningPolicy, parse_domain

ACTIONS = ("go", "swim", "look")
DOMAIN = """(define (domain faulty) (:requirements :typing :durative-actions :action-costs) (:types action place)
  (:predicates (action_feasible ?a - action) (go_action ?a - action) (swim_action ?a - action) (look_action ?a - action)
    (at ?x - place) (path ?x ?y - place) (river ?x ?y - place) (seen ?x - place) (noise ?x - place) (safe))
  (:functions (total-cost) - number (far ?x ?y - place) - number)
  (:durative-action go :parameters (?a - action ?x ?y - place) :duration (= ?duration 1)
    :condition (and (at start (at ?x)) (over all (path ?x ?y)) (over all (go_action ?a))
      (over all (action_feasible ?a)))
    :effect (and (at start (not (at ?x))) (at end (at ?y)) (at end (increase (total-cost) (far ?x ?y)))))
  (:durative-action swim :parameters (?a - action ?x ?y - place) :duration (= ?duration 1)
    :condition (and (at start (at ?x)) (over all (river ?x ?y)) (over all (swim_action ?a))
      (over all (action_feasible ?a)))
    :effect (and (at start (not (at ?x))) (at end (at ?y)) (at end (increase (total-cost) (far ?x ?y)))))
  (:durative-action look :parameters (?a - action ?x - place) :duration (= ?duration 1)
    :condition (and (over all (at ?x)) (over all (look_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (seen ?x)) (at end (increase (total-cost) 1))))
  (:action rest :parameters () :precondition (not (safe)) :effect (safe)))
"""
QUIET_S = 400.0


class Ground:
    """Places with paths and rivers; shared by many episodes, as its task is translated once."""

    def __init__(self, seed):
        rng = default_rng(seed)
        self.places = [f"p{number}" for number in range(6)]
        pairs = [(x, y) for x in self.places for y in self.places if x != y]
        self.moves = {
            kind: [pairs[number] for number in rng.choice(len(pairs), 9, replace=False)]
            for kind in ("go", "swim")
        }
        self.wanted = [str(one) for one in rng.choice(self.places, 2, replace=False)]
        far = {pair: float(rng.integers(1, 20)) for pair in pairs}
        facts = [f"(path {x} {y})" for x, y in self.moves["go"]] + [
            f"(river {x} {y})" for x, y in self.moves["swim"]
        ]
        facts += [f"(= (far {x} {y}) {length})" for (x, y), length in far.items()]
        goal = " ".join(f"(seen {place})" for place in self.wanted)
        problem = f"""(define (problem p) (:domain faulty)
          (:objects go swim look - action {" ".join(self.places)} - place)
          (:init (go_action go) (swim_action swim) (look_action look) (at p0) (= (total-cost) 0) {" ".join(facts)})
          (:goal (and {goal})) (:metric minimize (total-cost)))"""
        self.domain = parse_domain(DOMAIN, problem)
        self.far = far
        self.planner = Planner()


class Doing(Behaviour):
    """A step that ends well, or fails for ever or by chance, as the world has it.

    It knows where the robot is.
    """

    def __init__(self, step, world):
        super().__init__(str(step))
        self.step = step
        self.world = world

    def initialise(self):
        self.left = 3
        world = self.world
        step = self.step
        assert step.schema in ("rest", "look") or step.arguments[1] == world.at, (
            f"{step} begun at {world.at}"
        )
        world.begun[step] += 1

    def update(self):
        self.left -= 1
        if self.left:
            return Status.RUNNING
        world = self.world
        step = self.step
        if step in world.broken or world.rng.random() < world.mishaps:
            return Status.FAILURE
        if step.schema == "look":
            world.seen.add(step.arguments[1])
        elif step.schema != "rest":
            world.at = step.arguments[2]
        return Status.SUCCESS


class Faulty:
    """Plans, or has trouble by chance."""

    timeout_s = 120.0

    def __init__(self, planner):
        self.planner = planner
        self.world = None

    def start(self, problem):
        future = Future()
        if self.world.rng.random() < self.world.troubles:
            future.set_result(PlanningResult(Outcome.ENGINE_CRASHED, engine="faulty"))
        else:
            future.set_result(self.planner.plan(problem))
        return future


def reachable(ground, world):
    """By brute force: whether all that is wanted can be seen, with what is feasible and not broken now."""

    def can(kind, *arguments):
        return (
            kind not in world.kb.unfeasible
            and world.domain.step(kind, [kind, *arguments]) not in world.broken
        )

    frontier = [world.at]
    known = {world.at}
    while frontier:
        here = frontier.pop()
        for kind in ("go", "swim"):
            for x, y in ground.moves[kind]:
                if x == here and y not in known and can(kind, x, y):
                    known.add(y)
                    frontier.append(y)
    # one direction may be all there is, so the order counts where places cannot be left again
    orders = [(one, other) for one in ground.wanted for other in ground.wanted if one != other]
    left = [place for place in ground.wanted if place not in world.seen]
    if not all(can("look", place) for place in left):
        return False

    def leads(x, y):
        seen = {x}
        some = [x]
        while some:
            here = some.pop()
            for kind in ("go", "swim"):
                for a, b in ground.moves[kind]:
                    if a == here and b not in seen and can(kind, a, b):
                        seen.add(b)
                        some.append(b)
        return y in seen

    if len(left) < 2:
        return all(place in known for place in left)
    return any(leads(world.at, one) and leads(one, other) for one, other in orders)


def episode(ground, seed):
    """Let things go wrong for a while, then leave it in peace.

    Return how many plans there were, and how it ended.
    """
    rng = default_rng(seed)
    policy = ReplanningPolicy(at_most_every_s=float(rng.choice([0.0, 0.2])))
    planner = Faulty(ground.planner)
    world = World(ground.domain, planner, task=Doing, policy=policy)
    planner.world = world
    world.rng = rng
    world.at = "p0"
    world.seen = set()
    world.begun = Counter()
    moves = [
        world.domain.step(kind, [kind, *pair])
        for kind in ("go", "swim")
        for pair in ground.moves[kind]
    ]
    world.broken = {
        moves[number] for number in rng.choice(len(moves), rng.integers(0, 7), replace=False)
    }
    world.mishaps = 0.3
    world.troubles = 0.2
    status = Status.RUNNING
    for _ in range(150):
        if rng.random() < 0.2:
            world.kb.unfeasible = {action for action in ACTIONS if rng.random() < 0.3}
        if rng.random() < 0.3:
            x, y = ground.moves["go"][rng.integers(len(ground.moves["go"]))]
            world.facts = {
                **world.facts,
                f"(far {x} {y})": ground.far[x, y] * float(rng.uniform(0.5, 2.0)),
            }
        world.facts = {
            **world.facts,
            f"(noise p{rng.integers(6)})": bool(rng.integers(2)),
            "(noise nowhere)": True,
        }
        if rng.random() < 0.02:
            world.executor.stop(Status.INVALID)
        status = tick(world)
        forgotten = (
            dict.fromkeys([f"(seen {place})" for place in world.seen], False)
            if status is Status.SUCCESS
            else {}
        )
        world.seen = set() if forgotten else world.seen
        world.facts = {
            text: value for text, value in world.facts.items() if not text.startswith("(seen")
        } | forgotten
    world.mishaps = world.troubles = 0.0
    world.kb.unfeasible = {action for action in ACTIONS if rng.random() < 0.15}
    could = can = reachable(ground, world)
    ends = Counter()
    before = len(world.executor.plans)
    for _ in range(round(QUIET_S * 10)):
        status = tick(world)
        world.facts = {
            text: value for text, value in world.facts.items() if not text.startswith("(seen")
        }
        ends[status] += 1
        if status is Status.SUCCESS:
            break
        if (
            ends[Status.FAILURE] % 700 == 1
        ):  # what is broken shows when it is tried, perhaps with no way back
            can = reachable(ground, world)
            if not can and ends[Status.FAILURE] > 700:
                break
    assert (status is Status.SUCCESS) == can, (seed, status, can, world.executor.feedback_message)
    assert could or not can
    assert not can or set(ground.wanted) <= world.seen
    # without an end in sight it is asked a few times a minute
    assert len(world.executor.plans) - before <= 200
    world.executor.stop(Status.INVALID)
    assert world.executor.current_steps == ()
    return len(world.executor.plans), can


def tick(world):
    status = world.tick()
    running = {step.action for step in world.executor.current_steps}
    assert not running & world.kb.unfeasible
    assert status is not Status.SUCCESS or set(map(str, world.executor.goals)) <= {
        f"(seen {p})" for p in world.seen
    }
    return status
