"""Random worlds with fuel that is used and filled up, samples that come and go, and steps side by side."""

from collections import deque
from itertools import product

from pddl_world import World
from py_trees.common import Status

from rosa_pddl import parse_domain
from rosa_pddl.validate import ended, goal_holds, missing_at_start, started

DOMAIN = """(define (domain whole) (:types place sample)
  (:predicates (at ?p - place) (road ?a ?b - place) (station ?p - place) (lies ?s - sample ?p - place)
    (analysed ?s - sample) (sent ?s - sample) (antenna))
  (:functions (fuel) (far ?a ?b - place))
  (:durative-action drive :parameters (?a ?b - place) :duration (= ?duration 1)
    :condition (and (at start (at ?a)) (over all (road ?a ?b)) (at start (>= (fuel) (far ?a ?b))))
    :effect (and (at start (not (at ?a))) (at end (at ?b)) (at start (decrease (fuel) (far ?a ?b)))))
  (:durative-action fill :parameters (?p - place) :duration (= ?duration 1)
    :condition (and (over all (at ?p)) (at start (station ?p)) (at start (< (fuel) 5)))
    :effect (at end (increase (fuel) 4)))
  (:durative-action analyse :parameters (?s - sample ?p - place) :duration (= ?duration 1)
    :condition (and (over all (at ?p)) (over all (lies ?s ?p)) (at start (>= (fuel) 1)))
    :effect (at end (analysed ?s)))
  (:durative-action send :parameters (?s - sample) :duration (= ?duration 1)
    :condition (and (at start (analysed ?s)) (at start (antenna)))
    :effect (and (at start (not (antenna))) (at end (antenna)) (at end (sent ?s)))))"""
_MOST_TICKS = 2000


def random_domain(rng):
    places = [f"p{number}" for number in range(int(rng.integers(2, 5)))]
    roads = [
        (a, b, int(rng.integers(1, 5)))
        for a, b in product(places, places)
        if a != b and rng.random() < 0.55
    ]
    facts = [f"(road {a} {b}) (= (far {a} {b}) {far})" for a, b, far in roads]
    facts += [f"(station {place})" for place in places if rng.random() < 0.4]
    samples = [f"s{number}" for number in range(int(rng.integers(1, 3)))]
    facts += [f"(lies {sample} {rng.choice(places)})" for sample in samples]
    goal = (
        "(forall (?s - sample) (sent ?s))"
        if rng.random() < 0.7
        else f"(and (sent s0) (>= (fuel) {rng.integers(1, 6)}))"
    )
    return parse_domain(
        DOMAIN,
        f"""(define (problem p) (:domain whole) (:objects {" ".join(places)} - place {" ".join(samples)} - sample)
        (:init (at p0) (antenna) (= (fuel) {rng.integers(0, 9)}) {" ".join(facts)}) (:goal {goal}))""",
    )


def can_be_reached(domain, state, goals):
    """Look at every state that steps in turn lead to: whether the goals can be reached."""
    choices = {
        name: [domain.objects_of(kind) for _, kind in domain.schema_of[name].parameters]
        for name in domain.schemas
    }
    steps = [
        domain.step(name, words) for name, lists in choices.items() for words in product(*lists)
    ]
    queue = deque([state])
    seen = {state}
    while queue:
        state = queue.popleft()
        if goal_holds(domain, state, goals):
            return True
        for step in steps:
            if missing_at_start(domain, step, state) is None:
                after = ended(domain, step, started(domain, step, state))
                if after not in seen:
                    seen.add(after)
                    queue.append(after)
    return False


def episode(rng, planner):
    """Run a world to its end; return whether the goal was and could be reached.

    Samples come and go, fuel is lost and roads are closed at random ticks; what could be reached is
    asked of brute force when the executor has ended and nothing happens any more. An end that never
    comes raises.
    """
    domain = random_domain(rng)
    world = World(domain, planner)
    world.ticks = {schema: int(rng.integers(1, 6)) for schema in domain.schemas}
    events = sorted(int(integer) for integer in rng.integers(0, 60, size=int(rng.integers(0, 4))))
    for tick in range(_MOST_TICKS):
        status = world.tick()
        world.facts = {
            text: known for text, known in world.facts.items() if not text.startswith("(fuel")
        }
        while events and events[0] <= tick:
            events.pop(0)
            happen(rng, world)
            status = Status.RUNNING
        if status is not Status.RUNNING and not events:
            world.tick()  # what has just happened is taken in
            if world.executor.status is not Status.RUNNING:
                break
    else:
        raise AssertionError(f"endless: {world.executor.feedback_message}")
    state = world.executor.state
    executor = world.executor
    known = executor._domain
    goals = [goal.expression for goal in executor.goals]
    return executor.status is Status.SUCCESS, can_be_reached(known, state, goals)


def happen(rng, world):
    executor = world.executor
    kind = rng.random()
    samples = executor.objects("sample")
    places = executor.objects("place")
    if kind < 0.45:
        name = f"n{len(samples)}_{world.tick_number}"
        world.facts[f"{name} - sample"] = True
        world.facts[f"(lies {name} {rng.choice(places)})"] = True
    elif kind < 0.6 and len(samples) > 1:
        gone = str(samples[-1])
        world.facts = {
            text: known
            for text, known in world.facts.items()
            if gone not in text.split(")")[0].split()
        }
        executor.remove_object(gone)
    elif kind < 0.8:
        world.facts["(fuel)"] = int(rng.integers(0, 6))
    else:
        roads = sorted(fact for fact in executor.state if fact.startswith("(road"))
        if roads:
            world.facts[str(rng.choice(roads))] = False
