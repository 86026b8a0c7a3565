"""The best joint choice of designs and configurations, proven by CP-SAT.

The only file that imports OR-tools; import it late, as that takes a while. One worker, a fixed seed and an effort that
is counted in work done instead of seconds make the answer the same on every machine.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from kb.exceptions import KnowledgeBaseError
from kb.planners.choice import Optimum, number
from kb.planners.encoding import Effect, Picks, Problem, Slot

try:
    from ortools.sat.python import cp_model
except ImportError as error:
    missing = "the best configuration is proven with OR-tools, which is not installed"
    raise KnowledgeBaseError(f"{missing}; pip install 'rosa-taca[optimal]' brings it") from error

EFFORT: Final = 0.3
"""How much work is done by default at most, in CP-SAT's deterministic time: about a second of a processor."""

_SETTINGS: Final = {
    "num_workers": 1,
    "random_seed": 0,
    "linearization_level": 2,  # the relaxation proves these problems almost alone
    "cp_model_probing_level": 0,
    "max_presolve_iterations": 1,
    "cut_level": 0,  # cuts cost more than they save here
    "symmetry_level": 0,
    "catch_sigint_signal": False,
}

Untyped = Any  # what OR-tools makes: a variable, an expression, a status
Literals = Sequence[Untyped]


def solve(problem: Problem, effort: float = EFFORT) -> Optimum:
    """Return the best choice that an effort in CP-SAT's deterministic time finds; of equally good ones the first.

    That is the one with the first design by priority and name for the function declared first, and so on, and then the
    same for the configurations of its components.
    """
    return _Search(problem, effort).optimum()


class _Program:
    """A problem as a CP-SAT model: `picks` are the literals of each slot's options."""

    def __init__(self, problem: Problem) -> None:
        self.model: Any = cp_model.CpModel()
        self._problem = problem
        self._effects: list[tuple[Any, Effect]] = [(1, problem.fixed)]
        self._users: list[list[Literals]] = [[] for _ in problem.slots]
        self.picks = [self._slot(slot, users) for slot, users in zip(problem.slots, self._users, strict=True)]
        self.gain = cp_model.LinearExpr.sum([*self._sum(lambda effect: effect.gain), *self._levels()])
        self.cost = cp_model.LinearExpr.sum(self._sum(lambda effect: effect.cost))

    def load(self, place: int) -> Untyped:
        return cp_model.LinearExpr.sum(self._sum(lambda effect: effect.loads[place]))

    def set_first_of(self, value: int) -> None:
        """Ask for the choice of a value that comes first; the search goes in this order, unless it presolves."""
        self.model.add(self.gain >= value)
        self.model.clear_objective()
        self.model.clear_hints()
        for literals in self.picks:
            self.model.add_decision_strategy(literals, cp_model.CHOOSE_FIRST, cp_model.SELECT_MAX_VALUE)

    def read(self, solver: Untyped) -> Picks:
        found = ((place for place, one in enumerate(literals) if solver.value(one)) for literals in self.picks)
        return tuple(next(places, 0) for places in found)

    def _slot(self, slot: Slot, users: Sequence[Literals]) -> Literals:
        """Encode that one option is chosen exactly if the slot is needed, and enter who needs which component."""
        literals = [self.model.new_bool_var("") for _ in slot.options]
        options = list(zip(literals, slot.options, strict=True))
        for literal, option in options:
            self.model.add_hint(literal, option.is_now)
        self._effects += [(literal, option.effect) for literal, option in options]
        if slot.is_function:
            self.model.add_exactly_one(literals)
            for place in dict.fromkeys(place for option in slot.options for place in option.needs):
                self._users[place].append([literal for literal, option in options if place in option.needs])
            return literals
        needed = self.model.new_bool_var("")
        for one in users:  # of one function at most one option is chosen
            self.model.add(cp_model.LinearExpr.sum(one) <= needed)
        if slot.is_needed:
            self.model.add(needed == 1)
        else:
            self.model.add_bool_or([*(literal for one in users for literal in one), ~needed])
        self.model.add(cp_model.LinearExpr.sum(literals) == needed)
        self._effects.append((1 - needed, slot.idle))
        return literals

    def _sum(self, amount: Callable[[Effect], int]) -> list[Any]:
        amounts = ((literal, amount(effect)) for literal, effect in self._effects)
        return [literal * number for literal, number in amounts if number]

    def _levels(self) -> list[Any]:
        """Return a number for each attribute that is no better than any level of it that is chosen."""
        levels: dict[str, list[tuple[Any, int]]] = {}
        for literal, effect in self._effects:
            for name, level in effect.levels:
                levels.setdefault(name, []).append((literal, level))
        return [self._worst(chosen) for chosen in levels.values()]

    def _worst(self, levels: Sequence[tuple[Any, int]]) -> Untyped:
        low, high = min(0, *(level for _, level in levels)), max(0, *(level for _, level in levels))
        worst, unset = self.model.new_int_var(low, high, ""), self.model.new_bool_var("")
        for literal, level in levels:
            self.model.add(worst <= high - (high - level) * literal)
        self.model.add(worst <= high - high * unset)
        self.model.add(cp_model.LinearExpr.sum([literal for literal, _ in levels]) + unset >= 1)
        return worst


class _Search:
    """Searches for the best choice, with an effort that is used up."""

    def __init__(self, problem: Problem, effort: float) -> None:
        self._problem = problem
        self._effort = effort
        self._left = effort
        self._solver: Any = cp_model.CpSolver()
        for name, value in _SETTINGS.items():
            setattr(self._solver.parameters, name, value)

    def optimum(self) -> Optimum:
        program, problem = _Program(self._problem), self._problem
        for place, limit in enumerate(problem.limits):
            program.model.add(program.load(place) <= limit)
        program.model.maximize(program.gain)
        status = self._run(program)
        if status == cp_model.INFEASIBLE:
            return Optimum(None, None, None, None, 0.0, True, self._why_nothing_fits())
        if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
            within = f" that keeps within {problem.criterion.limits}" if problem.criterion.limits else ""
            reason = f"no choice{within} was found with an effort of {self._effort:g}"
            return Optimum(None, None, None, None, problem.resolution, False, reason)
        gains = round(self._solver.objective_value), round(self._solver.best_objective_bound)
        picks, cost, is_proven = program.read(self._solver), self._solver.value(program.cost), False
        if status == cp_model.OPTIMAL:
            program.set_first_of(gains[0])
            self._solver.parameters.search_branching = cp_model.FIXED_SEARCH
            self._solver.parameters.cp_model_presolve = False
            is_proven = self._run(program) in (cp_model.OPTIMAL, cp_model.FEASIBLE)
            if is_proven:
                picks, cost = program.read(self._solver), self._solver.value(program.cost)
        worth, most, switching = (float(amount * problem.unit) for amount in (*gains, cost))
        found = Optimum(problem.choice(picks), worth, switching, most, problem.resolution, is_proven, "")
        return replace(found, reason=self._reason(found))

    def _reason(self, found: Optimum) -> str:
        """Say what makes it the best, what it is worth, and how sure that is."""
        problem, effort = self._problem, f"an effort of {self._effort:g}"
        within = f" within {problem.criterion.limits}" if problem.criterion.limits else ""
        best = f"the best for {problem.criterion.goal}" if problem.criterion.goal else "the first by priority"
        if found.switching and not problem.criterion.goal:
            best = f"the one that is cheapest to switch to ({number(found.switching)}), and then the first by priority"
        worth = f", worth {found.worth}" if problem.criterion.goal else ""
        rounded = (
            f" by more than {number(found.resolution)}, to which its worth was rounded" if found.resolution else ""
        )
        if found.is_proven and not rounded:
            return f"of all choices{within} this is {best}{worth}"
        if not found.gap:
            unsure = "" if found.is_proven else f"; {effort} did not prove that it comes first"
            return f"no choice{within} is better than this one{rounded}{worth}{unsure}"
        assert found.bound is not None
        left = f"none is worth more than {number(found.bound)} (a gap of {number(found.gap)})"
        return f"this is {best}{within} that {effort} found{worth}; {left}"

    def _run(self, program: _Program) -> Untyped:
        self._solver.parameters.max_deterministic_time = max(self._left, 0.0)
        status = self._solver.solve(program.model)
        self._left -= self._solver.response_proto.deterministic_time
        return status

    def _why_nothing_fits(self) -> str:
        """Say which budget is too small for any choice, as far as the effort that is left allows."""
        problem, program, reasons = self._problem, _Program(self._problem), []
        for place, name in enumerate(problem.criterion.budgets):
            limit, unit = problem.limits[place], problem.load_units[place]
            program.model.minimize(program.load(place))
            if self._run(program) == cp_model.OPTIMAL and (least := round(self._solver.objective_value)) > limit:
                least_said, limit_said = number(float(least * unit)), number(float(limit * unit))
                reasons.append(f"{name} would be {least_said} at least, more than {limit_said}")
        return " and ".join(reasons) or f"no choice keeps within {problem.criterion.limits}"
