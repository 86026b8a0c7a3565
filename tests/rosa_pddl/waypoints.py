"""Generated worlds of waypoints: a robot with six configurations travels corridors that differ in cost and passability.

Which corridor can be passed with which configuration, and what that costs, is what a knowledge base would say.
"""

from math import hypot

from numpy.random import Generator

from rosa_pddl import load_domain

DOMAIN = """(define (domain waypoints)
  (:requirements :typing :action-costs)
  (:types place configuration)
  (:predicates (at ?p - place) (configured ?c - configuration) (passable ?from ?to - place ?c - configuration))
  (:functions (total-cost) - number (travel_cost ?from ?to - place ?c - configuration) - number
              (switch_cost ?c - configuration) - number)
  (:action travel
    :parameters (?from ?to - place ?c - configuration)
    :precondition (and (at ?from) (configured ?c) (passable ?from ?to ?c))
    :effect (and (not (at ?from)) (at ?to) (increase (total-cost) (travel_cost ?from ?to ?c))))
  (:action switch
    :parameters (?c ?d - configuration)
    :precondition (and (configured ?c) (not (= ?c ?d)))
    :effect (and (not (configured ?c)) (configured ?d) (increase (total-cost) (switch_cost ?d)))))
"""
CONFIGURATIONS = tuple(f"c{number}" for number in range(6))


class Waypoints:
    """Places in a square, all joined; from the first the robot shall come to the farthest."""

    def __init__(self, folder, size: int, rng: Generator):
        self.rng = rng
        points = rng.uniform(0.0, 100.0, size=(size, 2))
        self.places = [f"w{number}" for number in range(size)]
        self.corridors = set()
        for number, (x, y) in enumerate(points):
            near = sorted(
                range(size), key=lambda other: hypot(points[other][0] - x, points[other][1] - y)
            )
            # the nearest earlier one makes sure that there is a way to each
            for other in {*near[1:3], *[one for one in near if one < number][:1]}:
                self.corridors |= {(number, other), (other, number)}
        self.corridors = sorted(self.corridors)
        self.length = {(a, b): hypot(*(points[a] - points[b])) for a, b in self.corridors}
        farthest = max(range(size), key=lambda other: hypot(*(points[other] - points[0])))
        self.possible = [f"w{a} w{b} {c}" for a, b in self.corridors for c in CONFIGURATIONS]
        (folder / "domain.pddl").write_text(DOMAIN)
        (folder / "problem.pddl").write_text(self._problem(farthest))
        self.domain = load_domain(folder / "domain.pddl", folder / "problem.pddl")

    def situation(self, at: str = "w0"):
        """Return a state and costs such as a knowledge base may say next."""
        open_now = self.rng.random(len(self.possible)) < 0.7
        passable = {
            f"(passable {words})"
            for words, is_open in zip(self.possible, open_now, strict=True)
            if is_open
        }
        state = frozenset({f"(at {at})", "(configured c0)"} | passable)
        factors = self.rng.integers(5, 15, size=len(self.possible))
        costs = {f"(switch_cost {c})": 20.0 for c in CONFIGURATIONS}
        lengths = [self.length[corridor] for corridor in self.corridors for _ in CONFIGURATIONS]
        costs |= {
            f"(travel_cost {words})": float(1 + int(length * factor))
            for words, length, factor in zip(self.possible, lengths, factors, strict=True)
        }
        return state, costs

    @property
    def changing(self):
        """The atoms that may change though no action changes them."""
        return [f"(passable {words})" for words in self.possible]

    def _problem(self, farthest):
        return f"""(define (problem travel) (:domain waypoints)
  (:objects {" ".join(self.places)} - place {" ".join(CONFIGURATIONS)} - configuration)
  (:init (at w0) (configured c0) (= (total-cost) 0))
  (:goal (at w{farthest}))
  (:metric minimize (total-cost)))
"""
