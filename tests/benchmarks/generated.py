"""Models of any size, and things that happen to them; the same for the same seed.

A robot is a ring of subsystems of 50 elements, wired alike; the wiring is drawn once from the seed.
Each subsystem also uses a component and a function of the next one. So a thing that happens at one
place touches as many elements in a small robot as in a large one, and only what the size itself
costs can differ.

Per subsystem: 2 actions (3 functions each), 4 functions (2 designs each), 8 designs (2 or 3
components each, so that a component is in 1 to 4 of them), 8 components (every second one with 2
configurations), 8 configurations, 4 attributes and 16 constraints: 4 for each attribute, each on 1
to 3 actions, designs, components or configurations. So the number of attributes grows with the
robot, and each of them constrains 6 to 10 elements at every size.
"""

from collections.abc import Iterator
from itertools import product
from random import Random
from typing import NamedTuple

from kb import KnowledgeBase, Model, PriorityPlanner

SUBSYSTEM = 50
CALM = 0.5
BANDS = ((0.2, (">=", ">")), (0.4, (">=", ">")), (0.6, ("<=", "<")), (0.8, ("<=", "<")))
"""Thresholds of an attribute, and the operators to compare it by: all are satisfied at the calm
value."""


class Happening(NamedTuple):
    """A fact that changes: `what` is measured, failed, active, requested or selected."""

    what: str
    name: str
    value: float | bool


class Wiring(NamedTuple):
    """What belongs to what in every subsystem, by position within its kind."""

    functions: tuple[tuple[int, ...], ...]
    components: tuple[tuple[int, ...], ...]
    operators: tuple[str, ...]
    constrained: tuple[tuple[tuple[str, int], ...], ...]


def wiring(seed: int) -> Wiring:
    draw = Random(seed)
    pool = [
        *product(("designs", "components", "configurations"), range(8)),
        ("actions", 0),
        ("actions", 1),
    ]
    return Wiring(
        functions=(tuple(draw.sample((1, 2, 3), 2)), tuple(draw.sample(range(4), 3))),
        components=tuple(tuple(draw.sample(range(8), draw.choice((2, 3)))) for _ in range(8)),
        operators=tuple(draw.choice(operators) for _ in range(4) for _, operators in BANDS),
        constrained=tuple(tuple(draw.sample(pool, draw.randint(1, 3))) for _ in range(16)),
    )


WIRING = wiring(seed=0)


def robot(size: int, wired: Wiring = WIRING) -> Model:
    """Build a model of `size` elements, which is a multiple of 100."""
    assert size % (2 * SUBSYSTEM) == 0, size
    model = Model(f"robot of {size}")
    ring = range(size // SUBSYSTEM)
    for here in ring:
        for number in range(4):
            model.environmental_attribute(f"attribute {number} of {here}")
    for here in ring:
        for number in range(8):
            model.component(f"component {number} of {here}", kind="process")
    for here in ring:
        for number in range(8):
            owner = model.components[f"component {number // 2 * 2} of {here}"]
            owner.configuration(
                f"configuration {number} of {here}", {"gain": number / 8}, priority=number % 2
            )
    for here in ring:
        for number in range(4):
            model.function(f"function {number} of {here}")
    for here in ring:
        _add_designs(model, wired, here, (here + 1) % len(ring))
    for here in ring:
        _add_actions(model, wired, here, (here + 1) % len(ring))
    for here in ring:
        _add_constraints(model, wired, here)
    return model


def _add_designs(model: Model, wired: Wiring, here: int, beyond: int) -> None:
    for number, positions in enumerate(wired.components):
        components = [f"component {position} of {here}" for position in positions]
        if number == 2:
            components[-1] = f"component 0 of {beyond}"
        function = model.functions[f"function {number // 2} of {here}"]
        function.design(f"design {number} of {here}", components, priority=number % 2)


def _add_actions(model: Model, wired: Wiring, here: int, beyond: int) -> None:
    for number, positions in enumerate(wired.functions):
        functions = [f"function {position} of {here}" for position in positions]
        if number == 0:
            functions.append(f"function 0 of {beyond}")
        model.action(f"action {number} of {here}", requires=functions)


def _add_constraints(model: Model, wired: Wiring, here: int) -> None:
    for number, (operator, constrained) in enumerate(
        zip(wired.operators, wired.constrained, strict=True)
    ):
        attribute = model.attributes[f"attribute {number // 4} of {here}"]
        bound = BANDS[number % 4][0]
        compare = {
            ">=": attribute.__ge__,
            ">": attribute.__gt__,
            "<=": attribute.__le__,
            "<": attribute.__lt__,
        }
        elements = [
            getattr(model, table)[f"{table[:-1]} {one} of {here}"] for table, one in constrained
        ]
        model.constrain(elements, compare[operator](bound))


def at_work(model: Model) -> KnowledgeBase:
    """Return a knowledge base of a robot that is calm and busy in every subsystem."""
    kb = KnowledgeBase(model)
    for attribute in model.attributes:
        kb.measure(attribute, CALM)
    for here in range(len(model.actions) // 2):
        assert kb.request_action(f"action 1 of {here}")
    plan = PriorityPlanner().plan(kb)
    assert plan is not None
    for component in plan.activate:
        kb.component_active(component, True)
    kb.finish_plan(plan, "completed")
    return kb


def disturbance(
    kind: str, subsystem: int, draw: Random, wired: Wiring = WIRING
) -> tuple[Happening, Happening]:
    """Draw a thing that happens to a subsystem of a robot at work, and the end of it."""
    chosen = [2 * function for function in wired.functions[1]]
    used = [
        component
        for design in chosen
        for component in wired.components[design][: 1 if design == 2 else 3]
    ]

    def both(
        what: str, name: str, first: float | bool, then: float | bool
    ) -> tuple[Happening, Happening]:
        name = f"{name} of {subsystem}"
        return Happening(what, name, first), Happening(what, name, then)

    if kind == "measured":
        return both(kind, f"attribute {draw.randrange(4)}", draw.choice((0.3, 0.7)), CALM)
    if kind == "requested":
        return both(kind, "action 1", False, True)
    if kind == "selected":
        return both(kind, f"design {draw.choice(chosen)}", False, True)
    return both(
        kind,
        f"component {draw.choice(used)}",
        *((True, False) if kind == "failed" else (False, True)),
    )


def story(
    kinds: tuple[str, ...],
    size: int,
    count: int,
    seed: int,
    overlap: int = 1,
    wired: Wiring = WIRING,
) -> Iterator[Happening]:
    """Yield `count` happenings all over the robot.

    As many disturbances as `overlap` go on at the same time.

    The places within the subsystems are the same at every size; which subsystems these are is not.
    """
    draw = Random(seed)
    where = Random(seed)
    open_ones: list[Happening] = []
    told = 0
    while True:
        for kind in kinds:
            begun, ended = disturbance(kind, where.randrange(size // SUBSYSTEM), draw, wired)
            open_ones.append(ended)
            for happening in (begun, *([open_ones.pop(0)] if len(open_ones) == overlap else [])):
                if told == count:
                    return
                told += 1
                yield happening


def tell(kb: KnowledgeBase, happening: Happening) -> bool:
    """Tell a knowledge base what happened; returns whether it was accepted."""
    what, name, value = happening
    if what == "measured":
        kb.measure(name, value)
    elif what == "failed":
        (kb.component_failed if value else kb.component_recovered)(name)
    elif what == "active":
        kb.component_active(name, bool(value))
    elif what == "selected":
        table = kb.designs if name in kb.model.designs else kb.configurations
        kb.assert_selected(table[name], bool(value))
    elif value:
        return bool(kb.request_action(name))
    else:
        kb.cancel_action(name)
    return True
