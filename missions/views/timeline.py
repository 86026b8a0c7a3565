"""What a picture shows of a recorded run: the page's rows as courses and spans of time."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from missions.views.rows import Recorded

Array = NDArray[np.float64]
Span = tuple[str, float, float]
"""A name, and from when to when it holds [s]."""
Entry = Mapping[str, Any]

SAMPLED_S: Final = 0.6
"""From one sample of a run to the next, at most."""
REPORTED_S: Final = 2.0
"""How long after it has happened a failure may be reported, at most."""
_ALL: Final = {"function design": ("function", "designs"), "configuration": ("component", "configurations")}


class RunTimeline:
    """A recorded run.

    Attributes:
        end: when it ended [s].
        times: of its poses (n,) [s].
        xy: where the robot was (n, 2) [m], world frame.
        actions, designs, configurations: what was done, and what was chosen where there was a choice.
        courses: what was measured (2, n), times [s] and values, by name; units by name.
        limits: labels of the thresholds by attribute and value.
        adaptations, disturbances: as in the page, in order of time; `unseen` are those that no panel shows.
        panels: the courses worth one, each with those that share it since their names end with its name.
    """

    def __init__(self, run: Recorded) -> None:
        self.run, self.end = run, max(run.rows[-1][0], 1e-3)
        self._elements = {key: one for _, key, one in run.track("element") if one is not None}
        poses = np.array([(time, *position[:2]) for time, _, position in run.track("pose")], dtype=float).reshape(-1, 3)
        self.times, self.xy = poses[:, 0], poses[:, 1:]
        acted = list(run.last("action").values())
        self.actions = [(self._name(one["action"]), one["start"], one["end"] or self.end) for one in acted]
        self.completed = [(self._name(one["action"]), one["end"]) for one in acted if one["result"] == "completed"]
        self.designs, self.configurations = map(list[Span], map(self._chosen, _ALL))
        self.units: dict[str, str] = {}
        self.courses = self._courses()
        self.limits = self._limits()
        self.adaptations: list[Entry] = sorted(run.last("adaptation").values(), key=lambda one: float(one["t"]))
        told: list[Entry] = list(run.last("disturbance").values())
        self.disturbances = sorted([*told, *self._failures(told)], key=lambda one: float(one["t"]))
        self.panels = self._panels()
        self.unseen = [one for one in self.disturbances if not one["words"].startswith(tuple(self.panels))]

    def where(self, time: float) -> Array:
        """Return where the robot was at a time [s]: (2,) [m]."""
        return np.array([np.interp(time, self.times, column) for column in self.xy.T])

    def legs(self) -> Iterator[tuple[str, str, Array]]:
        """Yield each part of the way with one action and one choice: these, and places (n, 2) [m]."""
        edges = sorted({time for _, *both in (*self.actions, *self.designs, *self.configurations) for time in both})
        legs: list[tuple[str, str, float, float]] = []
        for start, end in pairwise(edges):
            done, *chosen = (
                _at(spans, (start + end) / 2) for spans in (self.actions, self.designs, self.configurations)
            )
            choice = ", ".join(filter(None, chosen))
            if legs and legs[-1][:2] == (done, choice):
                start = legs.pop()[2]
            legs.append((done, choice, start, end))
        for done, choice, start, end in legs:
            if done and choice:
                yield done, choice, self.xy[(start <= self.times) & (self.times <= end)]

    def _name(self, key: int | str) -> str:
        return str(self._elements[key]["name"])

    def _chosen(self, kind: str) -> Iterator[Span]:
        """Yield when each was selected that has others beside it, unless it says no more than the action."""
        of, parts = _ALL[kind]
        since: dict[int | str, float] = {}
        spans: defaultdict[int, list[Span]] = defaultdict(list)
        for time, key, is_selected in [*self.run.track("selected"), *((self.end, key, 0) for key in self._elements)]:
            one = self._elements[key]
            if is_selected:
                since[key] = time
            elif key in since and one["kind"] == kind and len(self._elements[one[of]][parts]) > 1:
                spans[one[of]].append((one["name"], since.pop(key), time))
        for held in spans.values():
            doing = {(name, _at(self.actions, (start + end) / 2)) for name, start, end in held}
            names, actions = map(set, zip(*doing, strict=True))
            if kind != "configuration" or not len(actions) == len(doing) == len(names) > 1:
                yield from held

    def _courses(self) -> dict[str, Array]:
        points: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
        for time, key, value in (*self.run.track("value"), *self.run.track("signal")):
            signal, _, unit = str(key).partition(" [")
            name = signal if unit or key not in self._elements else self._name(key).replace("_", " ")
            self.units[name] = unit.rstrip("]") if unit else self._elements.get(key, {}).get("unit", "")
            if points[name] and time > points[name][-1][0] + 2 * SAMPLED_S:  # a signal is told when it changes
                points[name].append((time - SAMPLED_S, points[name][-1][1]))
            points[name].append((time, np.nan if value is None else value))
        worth = [str(name).replace("_", " ") for name in self.run.header.get("signals", ())] or list(points)
        worth = [name for name in worth if np.isfinite([value for _, value in points[name]]).any()]
        return {name: np.array([*points[name], (self.end, points[name][-1][1])]).T for name in worth}

    def _limits(self) -> dict[str, dict[float, list[str]]]:
        limits: dict[str, dict[float, list[str]]] = defaultdict(dict)
        for one in self._elements.values():
            if one["kind"] == "constraint":
                labels = limits[self._name(one["attribute"]).replace("_", " ")].setdefault(one["value"], [])
                labels += [f"{brief(one['operator'])} {one['value']:g}  {brief(self._name(key))}" for key in one["on"]]
        return limits

    def _panels(self) -> dict[str, list[str]]:
        worth = [name for name, (_, values) in self.courses.items() if name in self.limits or len({*values}) > 1]
        hosts = {name: next((one for one in worth if name.endswith(f" {one}")), name) for name in worth}
        return {host: [name for name in worth if hosts[name] == host != name] for host in worth if hosts[host] == host}

    def _failures(self, disturbances: Sequence[Entry]) -> Iterator[Entry]:
        """Yield the failures that were reported, but for those that a disturbance just before stands for."""
        for time, _, event in self.run.track("event"):
            is_told = any(0 <= time - one["t"] <= REPORTED_S for one in disturbances)
            if event["verb"] == "component_failed" and not is_told:
                yield {"t": time, "words": event["words"]}


def _at(spans: Sequence[Span], time: float) -> str:
    return ", ".join(dict.fromkeys(name for name, start, end in spans if start <= time < end))


def brief(text: str, most: int = 26) -> str:
    """Return a text as a picture has room for it, with signs instead of ASCII."""
    short = text.replace(" = ", "\u00a0=\u00a0").replace("->", "→").replace(">=", "≥").replace("<=", "≤")
    return short if len(short) <= most else f"{short[: most - 1]}…"
