"""The joint choice of designs and configurations as numbers: what each possibility adds, and what it needs.

What is left of the model is small: functions with options of which one is chosen, components that are needed by some
of these options and then have one option chosen too, and effects, which add up. All numbers are whole in the end, so
that of two choices one is better or they are exactly as good.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal, localcontext
from typing import Final, NamedTuple

from kb.inference.network import Node
from kb.selection import Choice

__all__ = ["ComponentOptions", "EXACTLY", "Effect", "FunctionOptions", "Option", "Picks", "Problem", "decimal", "whole"]

DIGITS: Final = 12
"""All effects of a kind together have no more digits than this as whole numbers; else they are rounded."""

EXACTLY: Final = Context(prec=60)
"""How decimal numbers are computed with before they are whole."""


class Effect(NamedTuple):
    """What something adds.

    Attributes:
        gain: to the value of the choice.
        loads: to what each budget limits.
        levels: weighted absolute estimations by attribute; of all that are chosen only the worst counts.
        cost: of switching; it is taken off the gain already.
    """

    gain: Decimal
    loads: tuple[Decimal, ...]
    levels: tuple[tuple[str, Decimal], ...] = ()
    cost: Decimal = Decimal()

    def plus(self, other: "Effect") -> "Effect":
        """Return both together."""
        loads = tuple(mine + its for mine, its in zip(self.loads, other.loads, strict=True))
        return Effect(self.gain + other.gain, loads, self.levels + other.levels, self.cost + other.cost)

    def costing(self, cost: Decimal) -> "Effect":
        """Return the same at a cost."""
        return self._replace(gain=self.gain - cost, cost=self.cost + cost)

    def is_no_worse_than(self, other: "Effect") -> bool:
        """Tell whether this can stand in place of the other whatever else is chosen."""
        lighter = all(mine <= its for mine, its in zip(self.loads, other.loads, strict=True))
        return lighter and self.gain >= other.gain and self.levels == other.levels


class Option(NamedTuple):
    """One possibility.

    Attributes:
        node: the design or configuration; None for a component that has nothing to be chosen.
        effect: what it adds if it is chosen; that of a configuration includes that its component runs.
        is_now: it is selected now.
        needs: positions of the components of a design that make a difference.
    """

    node: Node | None
    effect: Effect
    is_now: bool = False
    needs: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class FunctionOptions:
    """A function, and its options with the first by priority first."""

    node: Node
    options: tuple[Option, ...]


@dataclass(frozen=True, slots=True)
class ComponentOptions:
    """A component of some design.

    Attributes:
        node: the component.
        options: one of these is chosen if it is needed; the first by priority first.
        idle: what it adds if nothing needs it.
        idle_node: the configuration to select even then, if any.
        is_needed: something needs it whatever is chosen.
    """

    node: Node
    options: tuple[Option, ...]
    idle: Effect
    idle_node: Node | None
    is_needed: bool

    @property
    def is_silent(self) -> bool:
        """Whether it makes no difference how it runs, and if."""
        return all(option.effect == self.idle for option in self.options)


class Picks(NamedTuple):
    """Position of what is chosen among the options of each function, and of each component if it is needed."""

    functions: tuple[int, ...]
    components: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Problem:
    """What is to be chosen.

    Attributes:
        functions, components: what there is to choose from, in order of declaration.
        fixed: what is added whatever is chosen.
        budgets: the attributes that are limited.
        limits: what the load of each must not exceed.
        unit: what a gain of 1 stands for.
        load_units: what a load of 1 stands for, for each budget.
        resolution: two choices that differ by no more than this can seem equally good; 0 if all numbers are exact.
        is_touched: something is estimated of what takes part.
        goal: what is preferred, in words.
        within: the limits, in words.
    """

    functions: tuple[FunctionOptions, ...]
    components: tuple[ComponentOptions, ...]
    fixed: Effect
    budgets: tuple[str, ...]
    limits: tuple[Decimal, ...]
    is_touched: bool
    goal: str = ""
    within: str = ""
    unit: Decimal = Decimal(1)
    load_units: tuple[Decimal, ...] = ()
    resolution: float = 0.0

    @property
    def first(self) -> Picks:
        """The first option of everything."""
        return Picks((0,) * len(self.functions), (0,) * len(self.components))

    @property
    def now(self) -> Picks:
        """What is selected now, and the first option of what has nothing selected."""
        return Picks(*(tuple(_now(one.options) for one in many) for many in (self.functions, self.components)))

    @property
    def kept(self) -> Picks | None:
        """What is selected now, if that is something for everything."""
        picks = self.now
        chosen = [one.options[pick] for one, pick in zip(self.functions, picks.functions, strict=True)]
        chosen += [self.components[place].options[picks.components[place]] for place in self.needed(picks)]
        return picks if all(option.is_now or option.node is None for option in chosen) else None

    @property
    def bound(self) -> Decimal:
        """What no choice gains more than, budgets or not."""
        highest = [max(option.effect.gain for option in one.options) for one in self.functions]
        for one in self.components:
            highest.append(max(one.idle.gain, *(option.effect.gain for option in one.options)))
        return sum(highest, self.fixed.gain + self._highest_levels())

    def needed(self, picks: Picks) -> set[int]:
        """Return the positions of the components that a choice needs, of those that make a difference."""
        pairs = zip(self.functions, picks.functions, strict=True)
        needed = {place for one, pick in pairs for place in one.options[pick].needs}
        return needed | {place for place, one in enumerate(self.components) if one.is_needed}

    def effect(self, picks: Picks) -> Effect:
        """Return what a choice adds in all, each attribute's worst level counted as gain."""
        total, needed = self.fixed, self.needed(picks)
        for one, pick in zip(self.functions, picks.functions, strict=True):
            total = total.plus(one.options[pick].effect)
        for place, (component, pick) in enumerate(zip(self.components, picks.components, strict=True)):
            total = total.plus(component.options[pick].effect if place in needed else component.idle)
        worst: dict[str, Decimal] = {}
        for name, level in total.levels:
            worst[name] = min(level, worst.get(name, level))
        return Effect(sum(worst.values(), total.gain), total.loads, (), total.cost)

    def _highest_levels(self) -> Decimal:
        best: dict[str, Decimal] = {}
        for effect in self.effects():
            for name, level in effect.levels:
                best[name] = max(level, best.get(name, Decimal()))
        return sum(best.values(), Decimal())

    def effects(self) -> list[Effect]:
        """Return all effects there are, chosen or not."""
        effects = [self.fixed, *(option.effect for one in self.functions for option in one.options)]
        for component in self.components:
            effects += [component.idle, *(option.effect for option in component.options)]
        return effects

    def fits(self, effect: Effect) -> bool:
        """Tell whether no budget is exceeded."""
        return all(load <= limit for load, limit in zip(effect.loads, self.limits, strict=True))

    def choice(self, picks: Picks) -> Choice:
        """Return a choice by name; configurations that use more of a budget than now come after the others."""
        pairs = zip(self.functions, picks.functions, strict=True)
        designs = {one.node: design for one, pick in pairs if (design := one.options[pick].node)}
        needed = {part for design in designs.values() for part in design.parts}
        configurations = {}
        for one, pick in sorted(zip(self.components, picks.components, strict=True), key=_uses_more):
            node = one.options[pick].node if one.is_needed or one.node in needed else one.idle_node
            if node is not None:
                configurations[one.node.name] = node.name
        return Choice({node.name: design.name for node, design in designs.items()}, configurations)


def decimal(number: float) -> Decimal:
    """Return a number as it is written in decimals."""
    return Decimal(repr(float(number)))


def whole(problem: Problem) -> Problem:
    """Return the same in whole numbers; loads are rounded up, so that rounding exceeds no budget."""
    with localcontext(EXACTLY):
        effects = problem.effects()
        scale = _Scale.of(
            amount for one in effects for amount in (one.gain, one.cost, *(level for _, level in one.levels))
        )
        scales = [
            _Scale.of([limit, *(effect.loads[place] for effect in effects)])
            for place, limit in enumerate(problem.limits)
        ]

        def rounded(effect: Effect) -> Effect:
            loads = zip(effect.loads, scales, strict=True)
            return Effect(
                scale.rounded(effect.gain),
                tuple(one.rounded(load, ROUND_CEILING) for load, one in loads),
                tuple((name, scale.rounded(level)) for name, level in effect.levels),
                scale.rounded(effect.cost),
            )

        def all_rounded(options: Sequence[Option]) -> tuple[Option, ...]:
            return tuple(option._replace(effect=rounded(option.effect)) for option in options)

        return replace(
            problem,
            functions=tuple(replace(one, options=all_rounded(one.options)) for one in problem.functions),
            components=tuple(
                replace(one, options=all_rounded(one.options), idle=rounded(one.idle)) for one in problem.components
            ),
            fixed=rounded(problem.fixed),
            limits=tuple(one.rounded(limit, ROUND_FLOOR) for one, limit in zip(scales, problem.limits, strict=True)),
            unit=scale.unit,
            load_units=tuple(one.unit for one in scales),
            resolution=0.0 if scale.is_exact else float(scale.unit * len(effects)),
        )


def _uses_more(chosen: tuple[ComponentOptions, int]) -> bool:
    component, pick = chosen
    now = next((option.effect.loads for option in component.options if option.is_now), None)
    loads = component.options[pick].effect.loads
    return any(loads) if now is None else any(new > old for new, old in zip(loads, now, strict=True))


def _now(options: Sequence[Option]) -> int:
    return next((place for place, option in enumerate(options) if option.is_now), 0)


class _Scale(NamedTuple):
    """What 1 stands for when amounts are written as whole numbers, and whether they are exact so."""

    unit: Decimal
    is_exact: bool

    @classmethod
    def of(cls, amounts: Iterable[Decimal]) -> "_Scale":
        decimals, total = 0, Decimal()
        for amount in amounts:
            if amount:
                decimals = max(decimals, -int(amount.normalize().as_tuple().exponent))
                total += abs(amount)
        most = DIGITS - 1 - total.adjusted() if total else decimals
        return cls(Decimal(1).scaleb(-min(decimals, most)), decimals <= most)

    def rounded(self, amount: Decimal, rounding: str = ROUND_HALF_EVEN) -> Decimal:
        return (amount / self.unit).to_integral_value(rounding)
