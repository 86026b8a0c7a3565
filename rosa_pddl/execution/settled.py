"""What of a goal is settled already, by facts that no action changes, so that planners get the simpler rest.

Of `(forall (?s - sample) (imply (wanted ?s) (analysed ?s)))` a conjunction of what is to be analysed is left, when what
is wanted is for others to say.
"""

from collections import OrderedDict
from collections.abc import Iterable, Iterator

from rosa_pddl.domain import Domain, State, UpThing, head_of
from rosa_pddl.planning.grounding import lock_of
from rosa_pddl.validate import mentioned_atoms

__all__ = ["Unsettled"]

_MOST_REMEMBERED = 64


class Unsettled:
    """Leaves of goals what actions have to bring about.

    Args:
        domain: what `load_domain` returned.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._changed = {
            domain.outside[effect.fluent.fluent().name]
            for schema in domain.schema_of.values()
            for effect in schema.start_effects + schema.end_effects
        }
        self._lasting: dict[UpThing, tuple[str, ...]] = {}
        self._rests: OrderedDict[tuple[UpThing, tuple[bool, ...]], tuple[UpThing, ...]] = OrderedDict()

    def of(self, goals: Iterable[UpThing], state: State) -> tuple[UpThing, ...]:
        """Return goals that hold after a plan from a state exactly if the given ones do; no conjunction among them.

        Args:
            goals: what shall hold, as unified-planning expressions.
            state: the atoms that are true now.
        """
        return tuple(part for goal in goals for part in self._rest(goal, state))

    def _rest(self, goal: UpThing, state: State) -> tuple[UpThing, ...]:
        if goal not in self._lasting:
            atoms = mentioned_atoms(self._domain, [goal], (), {})
            self._lasting[goal] = tuple(sorted({atom for atom in atoms if head_of(atom) not in self._changed}))
        lasting = self._lasting[goal]
        if not lasting:
            return (goal,)
        key = goal, tuple(atom in state for atom in lasting)
        if key not in self._rests:
            with lock_of(self._domain):
                self._rests[key] = self._simplified(goal, dict(zip(lasting, key[1], strict=True)))
            if len(self._rests) > _MOST_REMEMBERED:
                self._rests.popitem(last=False)
        return self._rests[key]

    def _simplified(self, goal: UpThing, known: dict[str, bool]) -> tuple[UpThing, ...]:
        from unified_planning.model.walkers import ExpressionQuantifiersRemover

        problem, manager = self._domain.up_problem, self._domain.up_problem.environment.expression_manager
        ground = ExpressionQuantifiersRemover(problem.environment).remove_quantifiers(goal, problem)
        values = {self._domain.expression(atom): manager.Bool(holds) for atom, holds in known.items()}
        rest = ground.substitute(values).simplify()
        # planners say better than nothing at all why there is no plan
        return (goal,) if rest.is_false() else tuple(_conjuncts(rest))


def _conjuncts(formula: UpThing) -> Iterator[UpThing]:
    if formula.is_and():
        for part in formula.args:
            yield from _conjuncts(part)
    elif not formula.is_true():
        yield formula
