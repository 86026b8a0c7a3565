"""The slow twin of the knowledge base: it keeps facts only and computes every answer anew.

Transcribed from the written semantics, not from the implementation; it is the oracle of the quick
one.
"""

import copy
from typing import NamedTuple

COMPARE = {
    ">=": lambda measured, bound: measured >= bound,
    ">": lambda measured, bound: measured > bound,
    "<=": lambda measured, bound: measured <= bound,
    "<": lambda measured, bound: measured < bound,
}


class NaivePlan(NamedTuple):
    activate: frozenset
    deactivate: frozenset
    parameters: frozenset


class Naive:
    def __init__(self, model):
        self.model = model
        self.value = {}
        self.time = {}  # of the measurements, by name of attribute
        self.measurements = {}  # all of them as (time, value), by name of attribute
        self.now = 0.0
        self.failed = set()
        self.active = set()
        self.designs = set()  # names of the selected ones
        self.configurations = set()
        self.open_actions = set()
        self.asserted = {}  # by (kind, name); constraints by ("constraint", position)
        self.asserted_required = set()  # (kind, name)

    def measure(self, name, value):
        self.value[name] = value
        self.time[name] = self.now
        self.measurements.setdefault(name, []).append((self.now, value))

    # structure

    def own_constraints(self, element):
        return [
            number
            for number, one in enumerate(self.model.constraints)
            if any(it is element for it in one.constrained)
        ]

    def designs_of(self, function):
        return [design for design in self.model.designs.values() if design.function == function]

    def configurations_of(self, component):
        return [
            configuration
            for configuration in self.model.configurations.values()
            if configuration.component == component
        ]

    # required

    def action_required(self, name):
        return name in self.open_actions or ("action", name) in self.asserted_required

    def function_required(self, name):
        by_action = any(
            name in action.functions and self.action_required(action.name)
            for action in self.model.actions.values()
        )
        return by_action or ("function", name) in self.asserted_required

    def component_required(self, name):
        by_design = any(name in self.model.designs[chosen].components for chosen in self.designs)
        return by_design or ("component", name) in self.asserted_required

    def required(self, kind, name):
        return {
            "action": self.action_required,
            "function": self.function_required,
            "component": self.component_required,
        }[kind](name)

    # statuses

    def status(self, kind, name):
        if (kind, name) in self.asserted:
            return self.asserted[kind, name]
        return getattr(self, f"{kind}_status")(name)

    def violated(self, element):
        return any(
            self.status("constraint", number) == "violated"
            for number in self.own_constraints(element)
        )

    def constraint_status(self, number):
        constraint = self.model.constraints[number]
        if constraint.attribute not in self.value:
            return "not evaluated"
        attribute = self.model.attributes[constraint.attribute]
        if self.now - self.time.get(constraint.attribute, self.now) > attribute.max_age:
            return str(attribute.when_stale)
        if constraint.hysteresis or constraint.dwell or attribute.agreement != (1, 1):
            return self.debounced_status(constraint, attribute)
        holds = COMPARE[constraint.operator](self.value[constraint.attribute], constraint.value)
        return "satisfied" if holds else "violated"

    def debounced_status(self, constraint, attribute):
        """Return the status after looking at all measurements again, at every half second."""
        letter = DebouncedByTheLetter(constraint, attribute)
        for half_seconds in range(round(2 * self.now) + 1):
            letter.look(half_seconds / 2)
            for time, value in self.measurements[attribute.name]:
                if time == half_seconds / 2:
                    letter.measure(time, value)
        return letter.status

    def configuration_status(self, name):
        return "unfeasible" if self.violated(self.model.configurations[name]) else "feasible"

    def component_status(self, name):
        options = [configuration.name for configuration in self.configurations_of(name)]
        unfeasible = [
            option for option in options if self.status("configuration", option) == "unfeasible"
        ]
        required = self.component_required(name)
        if name in self.failed:
            return "failure"
        if (options and unfeasible == options) or self.violated(self.model.components[name]):
            return "unfeasible"
        if required and any(one in self.configurations for one in unfeasible):
            return "configuration error"
        if required and name not in self.active:
            return "unsolved"
        if required and options and not any(option in self.configurations for option in options):
            return "unsolved"
        return "solved" if required else "feasible"

    def design_status(self, name):
        design = self.model.designs[name]
        parts = [self.status("component", component) for component in design.components]
        if self.violated(design) or "failure" in parts or "unfeasible" in parts:
            return "unfeasible"
        if name in self.designs and "configuration error" in parts:
            return "implicit configuration error"
        if name in self.designs and any(part != "solved" for part in parts):
            return "unsolved"
        return "solved" if name in self.designs else "feasible"

    def function_status(self, name):
        options = {
            design.name: self.status("design", design.name) for design in self.designs_of(name)
        }
        selected = [options[option] for option in options if option in self.designs]
        if not options or all(option == "unfeasible" for option in options.values()):
            return "unfeasible"
        if not self.function_required(name):
            return "feasible"
        if "unfeasible" in selected:
            return "configuration error"
        if "implicit configuration error" in selected:
            return "implicit configuration error"
        return "solved" if "solved" in selected else "unsolved"

    def action_status(self, name):
        action = self.model.actions[name]
        needs = [self.status("function", function) for function in action.functions]
        if self.violated(action) or "unfeasible" in needs:
            return "unfeasible"
        if not self.action_required(name):
            return "feasible"
        if "configuration error" in needs or "implicit configuration error" in needs:
            return "implicit configuration error"
        return "unsolved" if any(need != "solved" for need in needs) else "solved"

    # questions

    def _is_adaptable(self, kind, element):
        status = self.status(kind, element.name)
        return status in ("unsolved", "configuration error") or (
            element.always_improve and status == "solved"
        )

    def adaptable_functions(self):
        return {
            function.name
            for function in self.model.functions.values()
            if self._is_adaptable("function", function)
        }

    def adaptable_components(self, designs=()):
        supposed = copy.copy(self)
        supposed.designs = set(self.designs)
        supposed.configurations = set(self.configurations)
        supposed.mark({self.model.designs[name].function: name for name in designs}, {})
        return {
            component.name
            for component in self.model.components.values()
            if supposed._is_adaptable("component", component)
        }

    def selectable_actions(self):
        return {name for name in self.model.actions if self.status("action", name) != "unfeasible"}

    def selectable_designs(self, function):
        return {
            design.name
            for design in self.designs_of(function)
            if self.status("design", design.name) != "unfeasible"
        }

    def selectable_configurations(self, component):
        options = self.configurations_of(component)
        return {
            option.name
            for option in options
            if self.status("configuration", option.name) != "unfeasible"
        }

    def usable_by(self, component):
        """Functions that could use a component: those with a design that contains it."""
        return {
            design.function
            for design in self.model.designs.values()
            if component in design.components
        }

    def obsolete_components(self):
        return {
            one for one in self.active if not any(map(self.function_required, self.usable_by(one)))
        }

    def obsolete_designs(self):
        return {
            design
            for design in self.designs
            if not self.function_required(self.model.designs[design].function)
        }

    def obsolete_configurations(self):
        component = {
            configuration: self.model.configurations[configuration].component
            for configuration in self.configurations
        }
        return {
            configuration
            for configuration in self.configurations
            if not any(map(self.function_required, self.usable_by(component[configuration])))
        }

    # selecting

    def mark(self, designs, configurations):
        """Select what is chosen, unselect its rivals and what is obsolete.

        Return the designs replaced by rivals.
        """
        replaced = set()
        for function, chosen in designs.items():
            replaced |= {
                design.name for design in self.designs_of(function) if design.name in self.designs
            } - {chosen}
            self.designs.add(chosen)
        self.designs -= replaced
        for component, chosen in configurations.items():
            self.configurations -= {
                configuration.name for configuration in self.configurations_of(component)
            }
            self.configurations.add(chosen)
        obsolete = self.obsolete_designs(), self.obsolete_configurations()
        self.designs -= obsolete[0]
        self.configurations -= obsolete[1]
        return replaced

    def needed_components(self):
        """Components of all selected designs of required functions."""
        designs = [self.model.designs[name] for name in self.designs]
        return {
            part
            for design in designs
            if self.function_required(design.function)
            for part in design.components
        }

    def select(self, designs, configurations):
        before = set(self.configurations)
        replaced = self.mark(designs, configurations)
        needed = self.needed_components()
        dropped = {part for name in replaced for part in self.model.designs[name].components}
        plan = NaivePlan(
            frozenset(needed - self.active),
            frozenset(((dropped & self.active) - needed) | self.obsolete_components()),
            frozenset(self.configurations - before),
        )
        return plan if any(plan) else None


class DebouncedByTheLetter:
    """One debounced constraint: its status, since when, and what the measurements say."""

    def __init__(self, constraint, attribute):
        self.constraint = constraint
        self.attribute = attribute
        self.status = "not evaluated"
        self.since = None
        self.votes = []
        self.measured = None
        self.is_silent = False
        self.candidate = None
        self.candidate_since = None

    def measure(self, now, value):
        self.votes = [*self.votes, value][-self.attribute.agreement[1] :]
        self.measured = now
        self.look(now)

    def look(self, now):
        if self.measured is not None and now - self.measured > self.attribute.max_age:
            policy = str(self.attribute.when_stale)
            self.__init__(self.constraint, self.attribute)
            self.status = policy
            self.is_silent = True
        if self.is_silent:
            self._look_after_silence(now)
            return
        vote = self._vote(self.status)
        may_change = self.status == "not evaluated" or now >= self.since + self.constraint.dwell
        if vote not in (None, self.status) and may_change:
            self.status = vote
            self.since = now

    def _look_after_silence(self, now):
        vote = self._vote("violated")
        if vote != self.candidate:
            self.candidate = vote
            self.candidate_since = now
        if vote is not None and now >= self.candidate_since + self.constraint.dwell:
            self.status = vote
            self.since = now
            self.is_silent = False

    def _vote(self, before):
        bound = self.constraint.value
        if before == "violated" and self.constraint.hysteresis:
            is_lower_bound = self.constraint.operator in (">=", ">")
            bound += self.constraint.hysteresis * (1 if is_lower_bound else -1)
        holds = COMPARE[self.constraint.operator]
        satisfied = sum(holds(value, bound) for value in self.votes)
        enough = self.attribute.agreement[0]
        if satisfied >= enough:
            return "satisfied"
        return "violated" if len(self.votes) - satisfied >= enough else None
