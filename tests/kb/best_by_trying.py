"""The slow twin of the optimiser: it carries out each choice on a copy and sums up estimations."""

from fractions import Fraction
from itertools import product

from kb.planning import by_priority
from kb.status import Status


def exact(number):
    return Fraction(repr(float(number)))


def ranked(state, node):
    possible = [part for part in node.requires if state.status[part] is not Status.UNFEASIBLE]
    return sorted(possible, key=lambda part: by_priority(part.element))


def every_choice(state):
    """Yield the ranks, designs and configurations of every joint choice."""
    network = state.network
    required = [node for node in network.functions.values() if state.is_required(node)]
    free = [node for node in required if ranked(state, node)]
    kept = [
        part
        for node in required
        if node not in free
        for part in node.requires
        if part in state.selected
    ]
    served = [part for node in required for design in node.requires for part in design.requires]
    for ranks in product(*(range(len(ranked(state, node))) for node in free)):
        designs = [ranked(state, node)[rank] for node, rank in zip(free, ranks, strict=True)]
        needed = [part for design in (*designs, *kept) for part in design.requires]
        _, plan = state.decide(designs)
        given_up = plan.deactivate if plan else ()
        running = [part for part in served if part in state.asserted_required & state.active]
        needed += [part for part in running if part.name not in given_up]
        components = [
            node for node in network.components.values() if node in needed and ranked(state, node)
        ]
        for more in product(*(range(len(ranked(state, node))) for node in components)):
            chosen = [
                ranked(state, node)[rank] for node, rank in zip(components, more, strict=True)
            ]
            yield (ranks, more), designs, chosen


def outcome(state, designs, configurations, weights, cost=0.0):
    """Return what a choice is worth once it is carried out.

    The cost of switching is one for all.
    """
    flips, plan = state.decide([*designs, *configurations])
    after = state.after(flips)
    network = state.network
    steps = ((plan.activate, True), (plan.deactivate, False)) if plan else ()
    for names, active in steps:
        for name in names:
            node = network.components[name]
            (after.active.add if active else after.active.discard)(node)
    running = [node for node in network.components.values() if node in after.active]
    causers = [node for node in network.designs.values() if node in after.selected]
    causers += running
    causers += [part for node in running for part in node.requires if part in after.selected]
    causing = {node.element for node in causers}
    estimations = [
        estimation for estimation in network.model.estimations if estimation.causer in causing
    ]
    worth = Fraction(0)
    for attribute, weight in weights.items():
        mine = [estimation for estimation in estimations if estimation.attribute == attribute]
        levels = [exact(weight) * exact(one.value) for one in mine if one.kind == "absolute"]
        worth += min(levels, default=Fraction(0))
        worth += exact(weight) * sum(exact(one.adds) for one in mine if one.kind != "absolute")
    if plan is None:
        return worth
    switched = [*plan.activate, *plan.deactivate]
    commanded = [name for name in switched if network.components[name].element.kind != "plain"]
    return worth - exact(cost) * (len(commanded) + len(plan.parameters))


def best_by_trying(state, weights, cost=0.0):
    """Return the best value, and all choices of it whose parts have the lowest sum of ranks."""
    best = {}
    for ranks, designs, configurations in every_choice(state):
        worth = outcome(state, designs, configurations, weights, cost)
        key = -worth, sum(map(sum, ranks))
        best.setdefault(key, []).append((names(designs), names(configurations)))
    worth, rank = min(best)
    return -worth, best[worth, rank]


def names(chosen):
    return {node.used_by[0].name: node.name for node in chosen}
