"""The naive twins of the planner: every state that can be reached is looked at, the nearest first."""

from collections import deque
from heapq import heappop, heappush
from itertools import product

from rosa_pddl.validate import ended, goal_holds, missing_at_start, plan_cost, started


def ground_steps(domain):
    choices = {
        name: [domain.objects_of(kind) for _, kind in schema.parameters]
        for name, schema in domain.schema_of.items()
    }
    steps = [domain.step(name, words) for name, each in choices.items() for words in product(*each)]
    assert steps
    return steps


def following(domain, steps, state):
    for step in steps:
        if missing_at_start(domain, step, state) is None:
            yield step, ended(domain, step, started(domain, step, state))


def fewest_steps(domain, state, most=None):
    """Return the number of steps of the shortest plan.

    None if there is none, -1 if there are too many states.
    """
    steps = ground_steps(domain)
    depth = {state: 0}
    todo = deque([state])
    while todo:
        state = todo.popleft()
        if goal_holds(domain, state):
            return depth[state]
        for _, after in following(domain, steps, state):
            if after not in depth:
                depth[after] = depth[state] + 1
                todo.append(after)
        if most is not None and len(depth) > most:
            return -1
    return None


def least_cost(domain, state, costs=None):
    """Return what the cheapest plan costs; None if there is none."""
    steps = ground_steps(domain)
    queue = [(0, 0, state)]
    done = set()
    pushed = 0
    while queue:
        cost, _, state = heappop(queue)
        if goal_holds(domain, state):
            return float(cost)
        if state in done:
            continue
        done.add(state)
        for step, after in following(domain, steps, state):
            pushed += 1
            more = plan_cost(domain, [step], state, costs)
            heappush(queue, (cost + more, pushed, after))
    return None
