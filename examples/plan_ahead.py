"""Plan ahead: photograph the piers of a bridge only while it will be light enough to finish."""

from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_bt import RosaAction
from rosa_pddl import LastingFeasibility, PlanExecutor, Step, parse_domain

DOMAIN = """
(define (domain bridge)
  (:requirements :strips :typing :durative-actions :action-costs)
  (:types action pier)
  (:predicates (action_feasible ?a - action) (photograph_action ?a - action)
    (scan_action ?a - action) (seen ?p - pier))
  (:functions (total-cost))
  (:durative-action photograph
    :parameters (?a - action ?p - pier)
    :duration (= ?duration 40)
    :condition (and (over all (photograph_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (seen ?p)) (at end (increase (total-cost) 1))))
  (:durative-action scan ; with the laser, which needs no light
    :parameters (?a - action ?p - pier)
    :duration (= ?duration 60)
    :condition (and (over all (scan_action ?a)) (over all (action_feasible ?a)))
    :effect (and (at end (seen ?p)) (at end (increase (total-cost) 3)))))
"""
PROBLEM = """
(define (problem before_dusk) (:domain bridge)
  (:objects photograph scan - action north middle south - pier)
  (:init (photograph_action photograph) (scan_action scan) (= (total-cost) 0))
  (:goal (and (seen north) (seen middle) (seen south)))
  (:metric minimize (total-cost)))
"""
domain = parse_domain(DOMAIN, PROBLEM)

model = Model("bridge_robot")
light = model.environmental_attribute("light", low=0.0)
light.forecast("trend")  # nobody says how it goes on: that is seen
model.action("photograph", constraints=[light >= 20.0])
model.action("scan")


class Look(RosaAction):
    """Looks at a pier for as long as the domain says."""

    def __init__(self, step: Step, kb: KnowledgeBase) -> None:
        super().__init__(str(step), kb, step.schema)
        self.step = step
        self.base = kb

    def initialise(self) -> None:
        """Begin; called once."""
        self.began = self.base.now
        print(f"{self.began:4.0f} s  {self.step} begins")

    def update(self) -> Status:
        """Go on; called at each tick."""
        shortest_s, _ = domain.schema_of[self.step.schema].duration or (0.0, 0.0)
        is_over = self.base.now - self.began >= shortest_s
        return Status.SUCCESS if is_over else Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Say whether it was done for nothing; called when it ends."""
        if new_status is not Status.SUCCESS:
            print(
                f"{self.base.now:4.0f} s  {self.step} is given up "
                f"after {self.base.now - self.began:.0f} s"
            )


def evening(*, ahead: bool) -> None:
    """Run the mission; the light falls by 0.2 in a second, and by more from 120 s on."""
    now = 0.0
    kb = KnowledgeBase(model, clock=lambda: now)
    executor = PlanExecutor(
        "before dusk",
        kb=LastingFeasibility(kb, domain) if ahead else kb,  # all that is to be done for it
        domain=domain,
        behaviours=dict.fromkeys(("photograph", "scan"), lambda step: Look(step, kb)),
        sense=dict,
        clock=lambda: now,
    )
    shown = 0
    while executor.status is not Status.SUCCESS:
        kb.measure(
            "light", max(0.0, 55.0 - 0.2 * now - 0.6 * max(0.0, now - 120.0) + now % 3.0 - 1.0)
        )
        if now >= 60.0:  # until then it only watches
            executor.catch_up()
            executor.tick_once()
        for plan in executor.plans[shown:]:
            print(f"{now:4.0f} s  plan, {plan.reason}: {', '.join(map(str, plan.steps))}")
        shown = len(executor.plans)
        now += 1.0
    print(f"{now:4.0f} s  all is seen")
    executor.shutdown()


print("As things are:")
evening(ahead=False)
print("With what is forecast:")
evening(ahead=True)
