"""The goals of a plan executor, which may change while it runs, and how soft goals are put to a planner.

Soft goals become costs (Keyder and Geffner, "Soft goals can be compiled away", JAIR 36, 2009): at its end, a plan
collects each soft goal that holds, at no cost, or forgoes it at the cost of its worth. The cheapest plan then has the
best net benefit, so any planner that minimises costs can be used.
"""

from collections.abc import Iterator
from dataclasses import replace
from numbers import Real

from rosa_pddl.domain import (
    FEASIBLE,
    Domain,
    PlanningResult,
    Schema,
    UpThing,
    atoms_in,
    exact,
    fluents_in,
    head_of,
)
from rosa_pddl.exceptions import GoalError, nearest
from rosa_pddl.problem import lock_of
from rosa_pddl.syntax import Goal, conditions


class Goals:
    """The goals, in the order in which they were added; the first ones are those of the problem file.

    Each part of a conjunction is a goal of its own. Change goals between ticks, in the thread that ticks.

    Args:
        domain: what `load_domain` returned.

    Attributes:
        version: counts the changes.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._goals: dict[str, Goal] = {}
        self.version = 0
        for text in domain.goals:
            self._put(text, None)

    @property
    def hard(self) -> tuple[Goal, ...]:
        """The goals that must be reached."""
        return tuple(goal for goal in self if not goal.is_soft)

    @property
    def soft(self) -> tuple[Goal, ...]:
        """The goals that a plan may give up."""
        return tuple(goal for goal in self if goal.is_soft)

    def add(self, text: str, worth: float | None = None) -> None:
        """Add a goal; if it exists already, it gets the new worth.

        Args:
            text: a condition such as `(inspected north)`.
            worth: how much more a plan may cost to reach the goal, in the unit of the plan's cost (steps, if the
                problem has no metric); None if it must be reached. Each part of a conjunction gets this worth.

        Raises:
            GoalError: `text` is not a string, or the worth is not positive.
            PddlError: the text is not PDDL.
            UnknownNameError: the text has a name that the domain does not have.
        """
        if worth is not None and not (isinstance(worth, Real) and 0.0 < worth < float("inf")):
            raise GoalError(
                f"{text} is worth {worth}, expected more than 0; leave it out if it must be reached"
            )
        before = dict(self._goals)
        self._put(text, worth)
        self.version += before != self._goals

    def drop(self, text: str) -> None:
        """Remove a goal; each part of a conjunction is removed.

        Raises:
            GoalError: there is no such goal; other errors as in `add`.
        """
        read = [part.text for part in self._read(text)]
        for one in read:
            if one not in self._goals:
                raise GoalError(f"{one} is not among the goals; {nearest(one, self._goals)}")
        for one in read:
            self._goals.pop(one, None)
        self.version += 1

    def replace(self, *texts: str) -> None:
        """Replace all goals by these, which must be reached; without any text, no goal is left.

        Raises:
            The same errors as `add`.
        """
        read = [part for text in texts for part in self._read(text)]
        before, self._goals = self._goals, {part.text: part for part in read}
        self.version += before != self._goals

    def use(self, domain: Domain) -> None:
        """Switch to a domain with other objects, about which the goals may ask something else."""
        self._domain = domain
        self.version += 1

    def __contains__(self, text: object) -> bool:
        return text in self._goals

    def __iter__(self) -> Iterator[Goal]:
        return iter(tuple(self._goals.values()))

    def __len__(self) -> int:
        return len(self._goals)

    def __repr__(self) -> str:
        return f"Goals({', '.join(str(goal) for goal in self)})"

    def _put(self, text: str, worth: float | None) -> None:
        self._goals |= {part.text: part for part in self._read(text, worth)}

    def _read(self, text: str, worth: float | None = None) -> tuple[Goal, ...]:
        if not isinstance(text, str):
            raise GoalError(
                f"{text!r} is no goal, expected a condition as text such as '(inspected north)'"
            )
        # the thread of a planner may be using the same environment of unified-planning
        with lock_of(self._domain):
            return conditions(self._domain, text, worth)


class Relevance:
    """Which atoms a plan or a goal may depend on: those in goals, and those that actions need to reach goals.

    It tells predicates apart, not objects; only for `action_feasible` does it tell the ROSA actions apart.
    """

    def __init__(self, domain: Domain, goals: Goals) -> None:
        self._domain, self._goals = domain, goals
        self._seen = -1
        self._names: frozenset[str] = frozenset()
        self._feasible: frozenset[str] = frozenset()

    def matters(self, atom: str) -> bool:
        if self._seen != self._goals.version:
            self._seen = self._goals.version
            self._look()
        return (
            atom in self._feasible
            if self._domain.is_feasibility(atom)
            else head_of(atom) in self._names
        )

    def _look(self) -> None:
        domain = self._domain
        needed = fluents_in(goal.expression for goal in self._goals)
        known, used, looked_at = domain.rosa_actions, set[str](), -1
        while looked_at != len(needed):
            looked_at = len(needed)
            for name, axiom in domain.axioms.items():
                if domain.up_problem.fluent(domain.inside["predicate", name]) in needed:
                    needed |= fluents_in([axiom.condition])
            for schema in domain.schema_of.values():
                effects = schema.start_effects + schema.end_effects
                if any(effect.fluent.fluent() in needed for effect in effects):
                    looks = [
                        part for effect in effects for part in (effect.condition, effect.value)
                    ]
                    atoms = [*atoms_in((*schema.start, *schema.over_all, *schema.end, *looks))]
                    needed |= {atom.fluent() for atom in atoms}
                    of_others = any(
                        domain.outside[atom.fluent().name].lower() == FEASIBLE
                        and not (
                            atom.arg(0).is_parameter_exp()
                            and atom.arg(0).parameter().name == schema.action
                        )
                        for atom in atoms
                    )
                    used.update(
                        known if of_others else [one for one in known if domain.may_do(schema, one)]
                    )
        self._names = frozenset(domain.outside[fluent.name] for fluent in needed)
        in_goals = any(
            domain.is_feasibility(goal.text) or FEASIBLE in goal.text.lower()
            for goal in self._goals
        )
        relevant = known if in_goals else used
        self._feasible = frozenset(
            atom for atom, action in domain.feasibility.items() if action in relevant
        )


class SoftGoals:
    """Soft goals, compiled into a domain that has an action to collect and an action to forgo each of them.

    The unified-planning expression `goal` holds when each soft goal has been collected or forgone.
    """

    def __init__(self, base: Domain, goals: tuple[Goal, ...]) -> None:
        self.made_of = base, goals
        self._base, self._problem = base, base.up_problem.clone()
        manager = self._problem.environment.expression_manager
        self._inside, self._outside = dict(base.inside), dict(base.outside)
        settling, each = self._fluent("settling"), None if base.metric == "cost" else manager.Int(1)
        never = manager.Not(
            settling
        )  # after a collect or forgo, no other kind of action may follow
        self._schemas = {
            name: replace(
                one,
                start=(*one.start, never),
                over_all=(*one.over_all, never),
                cost=one.cost or each,
            )
            for name, one in base.schema_of.items()
        }
        self._collected_by: dict[str, Goal] = {}
        self.goal: UpThing = manager.TRUE()
        for number, goal in enumerate(goals):
            this = self._fluent(f"settled_{number}")
            collect = self._action(
                f"collect_{number}", (self.goal, goal.expression), (settling, this), 0
            )
            self._collected_by[collect] = goal
            self._action(f"forgo_{number}", (self.goal,), (settling, this), goal.worth or 0.0)
            self.goal = this
        self.domain = replace(
            base,
            schema_of=self._schemas,
            up_problem=self._problem,
            inside=self._inside,
            outside=self._outside,
            metric="cost",
        )

    def kept(self, result: PlanningResult) -> tuple[PlanningResult, tuple[Goal, ...]]:
        """Return a plan without its collect and forgo steps, and the soft goals that it reaches."""
        real = self._base.schema_of
        schedule = tuple(timed for timed in result.schedule if timed.step.schema in real)
        steps = tuple(step for step in result.steps if step.schema in real)
        reached = tuple(
            self._collected_by[step.schema]
            for step in result.steps
            if step.schema in self._collected_by
        )
        return replace(result, steps=steps, schedule=schedule), reached

    def _fluent(self, name: str) -> UpThing:
        unique = self._unique("predicate", name)
        return self._problem.add_fluent(unique, default_initial_value=False)()

    def _action(
        self, name: str, needed: tuple[UpThing, ...], made: tuple[UpThing, ...], cost: float
    ) -> str:
        from unified_planning.model import Effect

        unique, manager = self._unique("action", name), self._problem.environment.expression_manager
        effects = tuple(Effect(fluent, manager.TRUE(), manager.TRUE()) for fluent in made)
        price = manager.auto_promote(exact(cost))[0]
        self._schemas[unique] = Schema(unique, (), needed, (), (), (), effects, None, cost=price)
        return unique

    def _unique(self, kind: str, name: str) -> str:
        while name in self._outside:
            name += "_"
        self._outside[name] = self._inside[kind, name] = name
        return name
