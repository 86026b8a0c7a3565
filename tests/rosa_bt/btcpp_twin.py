"""A plain twin of BehaviorTree.CPP 4, to judge what is read from XML.

Written from how its nodes are documented and behave, without a thought of py_trees: a node has a
status of its own, `execute` asks pre-conditions, ticks and runs post-conditions, and a parent halts
and resets its children by name.
"""

import operator
import re
from collections import UserDict
from xml.etree import ElementTree

SCRIPT = re.compile(r"(@?\w+) (:?=|\+=) (!?)(\w+|[\d.]+)(?: (&) (\d+))?")
CONDITION = re.compile(r"(!?)(@?\w+)(?: ([<>=]+) ([\d.]+))?")


class Thrown(Exception):
    """What BehaviorTree.CPP would throw in the middle of a tick."""


def run(code, board):
    """Run a script of simple assignments, with numbers, names, `!` and `&`."""
    for statement in code.split("; "):
        name, sign, negation, text, _, mask = SCRIPT.fullmatch(statement).groups()
        before = board.get(name)
        value = float(text) if text[0].isdigit() else board[text]
        if "." not in text and text.isdigit():
            value = int(text)
        if negation:
            value = float(not value)
        if mask:
            value = float(whole(value) & int(mask))
        if sign == "+=":
            value += before
        if type(before) is int:
            value = whole(value)
        elif before is not None:
            value = type(before)(value)
        board[name] = value


def whole(value):
    if value != int(value):
        raise Thrown
    return int(value)


def holds(code, board):
    """Tell whether a condition holds: of names, `!`, or a comparison with a number."""
    negation, name, sign, number = CONDITION.fullmatch(code).groups()
    value = board[name]
    if sign:
        signs = {"==": operator.eq, "<": operator.lt, ">=": operator.ge}
        return signs[sign](value, float(number))
    return bool(value) != bool(negation)


IDLE, RUNNING, SUCCESS, FAILURE, SKIPPED = "IDLE", "RUNNING", "SUCCESS", "FAILURE", "SKIPPED"
DONE = (SUCCESS, FAILURE)
BY_LETTER = {"S": SUCCESS, "F": FAILURE, "R": RUNNING, "K": SKIPPED}


class Board(UserDict):
    """What one tree sees: entries by key (None: no value yet), and how often each was written."""

    def __init__(self, around=None, remapped=(), constants=(), *, is_auto=False):
        self.around = around
        self.remapped = dict(remapped)
        self.is_auto = is_auto
        self.written = dict.fromkeys(dict(constants), 1)
        self.own = frozenset(dict(constants))
        super().__init__()
        self.data.update(constants)

    def place(self, key):
        if self.around is None or key in self.own:
            return self, key.lstrip("@")
        if key.startswith("@") or (
            self.is_auto and key not in self.remapped and not key.startswith("_")
        ):
            return self.around.place(key)
        return self.around.place(self.remapped[key]) if key in self.remapped else (self, key)

    def __contains__(self, key):
        board, name = self.place(key)
        return name in board.data

    def __getitem__(self, key):
        board, name = self.place(key)
        return board.data[name]

    def __setitem__(self, key, value):
        board, name = self.place(key)
        board.data[name] = value
        board.written[name] = board.written.get(name, 0) + (value is not None)

    def times_written(self, key):
        board, name = self.place(key)
        return board.written.get(name)

    def unset(self, key):
        self.data.pop(key, None)
        self.written.pop(key, None)


class World:
    """What all nodes share: leaves by tag, what happened, blackboards, the time [s]."""

    def __init__(self, leaves, enums, ports):
        self.enums = enums
        self.ports = ports
        self.leaves = dict(leaves)
        self.ticked = dict.fromkeys(leaves, 0)
        self.said = []
        self.boards = [Board()]
        self.now = 0.0

    @property
    def board(self):
        return self.boards[0]


class Node:
    def __init__(self, tag, ports, children, world, board):
        self.tag = tag
        self.ports = ports
        self.children = children
        self.world = world
        self.board = board
        self.status = IDLE
        self.clear()

    def clear(self):
        """Forget counters and places."""

    def execute(self):
        status = self.judged()
        if status is None:
            status = self.tick()
        if status in DONE:
            self.follow("_onSuccess" if status == SUCCESS else "_onFailure", "_post")
        if status == IDLE:
            raise Thrown
        if status != SKIPPED:
            self.status = status
        return status

    def holds(self, code):
        return holds(code, self.board)

    def judged(self):
        for rule, verdict in (
            ("_failureIf", FAILURE),
            ("_successIf", SUCCESS),
            ("_skipIf", SKIPPED),
        ):
            if self.status == IDLE and rule in self.ports and self.holds(self.ports[rule]):
                return verdict
        if (
            "_while" in self.ports
            and self.status in (IDLE, RUNNING)
            and not self.holds(self.ports["_while"])
        ):
            if self.status == RUNNING:
                self.halt_node()
            return SKIPPED
        return None

    def follow(self, *rules):
        for rule in rules:
            if rule in self.ports:
                run(self.ports[rule], self.board)

    def halt_node(self):
        self.halt()
        self.follow("_onHalted")

    def halt(self):
        self.clear()
        self.reset_all()
        self.status = IDLE

    def reset(self, child):
        if child.status == RUNNING:
            child.halt_node()
        child.status = IDLE

    def reset_all(self):
        for child in self.children:
            self.reset(child)


class Leaf(Node):
    def tick(self):
        kind, script = self.world.leaves[self.tag]
        if kind == "A" and self.status in DONE:
            return self.status
        count = self.world.ticked[self.tag]
        ports = self.world.ports.get(self.tag, {})
        letter = script[count % len(script)]
        self.world.ticked[self.tag] += 1
        hook = "c" if kind == "C" else "s" if self.status == IDLE else "r"
        if ports.get("in"):
            self.world.said.append(f"{self.tag}.p={self.whole(self.ports.get('p', '?'))}")
        if ports.get("out") and "o" in self.ports:
            values = ports["out"]["o"][1]
            self.board[self.ports["o"][1:-1]] = values[count % len(values)]
        self.world.said.append(f"{self.tag}:{hook}:{letter}")
        return BY_LETTER[letter]

    def whole(self, text):
        found = self.board[text[1:-1]] if text[0] == "{" else text
        try:
            return int(found) if isinstance(found, str) or found == int(found) else "?"
        except (TypeError, ValueError):
            return "?"

    def halt(self):
        if self.world.leaves[self.tag][0] == "A":
            self.world.said.append(f"{self.tag}:halt")
        self.status = IDLE


class InOrder(Node):
    goes_on, remembers, is_async, skipped = SUCCESS, False, False, 0

    def clear(self):
        self.index = 0

    def halt(self):
        index = self.index
        super().halt()
        self.index = index if self.remembers else 0

    def tick(self):
        if self.status == IDLE:
            self.skipped = 0
        self.status = RUNNING
        while self.index < len(self.children):
            child = self.children[self.index]
            was_idle = child.status == IDLE
            status = child.execute()
            self.skipped += status == SKIPPED
            if status == RUNNING:
                return RUNNING
            if status in DONE and status != self.goes_on:
                self.give_up()
                return status
            self.index += 1
            if status != SKIPPED and self.is_async and was_idle and self.index < len(self.children):
                return RUNNING
        self.reset_all()
        self.index = 0
        skipped = self.skipped
        self.skipped = 0
        return SKIPPED if skipped == len(self.children) else self.goes_on

    def give_up(self):
        for child in self.children[self.index if self.remembers else 0 :]:
            self.reset(child)
        self.index = self.index if self.remembers else 0


class Reactive(Node):
    goes_on = SUCCESS

    def tick(self):
        self.status = RUNNING
        all_skipped = True
        for child in self.children:
            status = child.execute()
            all_skipped &= status == SKIPPED
            if status == RUNNING:
                for other in self.children:
                    if other is not child:
                        self.reset(other)
                return RUNNING
            if status == SKIPPED:
                self.reset(child)
            elif status != self.goes_on:
                self.reset_all()
                return status
        self.reset_all()
        return SKIPPED if all_skipped else self.goes_on


class Together(Node):
    def clear(self):
        self.ended = {}

    def threshold(self, port, default):
        count = len(self.children)
        wanted = int(self.ports.get(port, default))
        wanted = wanted if wanted >= 0 else max(count + wanted + 1, 0)
        if wanted > count:
            raise Thrown
        return wanted

    def number(self, status):
        return list(self.ended.values()).count(status)

    def end(self, status):
        self.clear()
        self.reset_all()
        return status


class Parallel(Together):
    def tick(self):
        successes = self.threshold("success_count", -1)
        failures = self.threshold("failure_count", 1)
        counts_skipped = int(self.ports.get("success_count", -1)) < 0
        self.status = RUNNING
        skipped = 0
        count = len(self.children)
        for child in self.children:
            if child not in self.ended:
                status = child.execute()
                skipped += status == SKIPPED
                if status in DONE:
                    self.ended[child] = status
            succeeded = self.number(SUCCESS)
            failed = self.number(FAILURE)
            if succeeded >= successes or (counts_skipped and succeeded + skipped >= successes):
                return self.end(SUCCESS)
            if count - failed < successes or failed == failures:
                return self.end(FAILURE)
        return SKIPPED if skipped == count else RUNNING


class ParallelAll(Together):
    def tick(self):
        failures = self.threshold("max_failures", 1)
        self.status = RUNNING
        skipped = 0
        for child in self.children:
            if child not in self.ended:
                status = child.execute()
                skipped += status == SKIPPED
                if status in DONE:
                    self.ended[child] = status
        if skipped == len(self.children):
            return SKIPPED
        if skipped + len(self.ended) < len(self.children):
            return RUNNING
        return self.end(FAILURE if self.number(FAILURE) >= failures else SUCCESS)


class IfThenElse(Node):
    def clear(self):
        self.chosen = 0

    def tick(self):
        self.status = RUNNING
        if self.chosen == 0:
            status = self.children[0].execute()
            if status == SKIPPED:
                raise Thrown
            if status == RUNNING or (status == FAILURE and len(self.children) == 2):
                return status
            self.chosen = 1 if status == SUCCESS else 2
        status = self.children[self.chosen].execute()
        if status != RUNNING:
            self.reset_all()
            self.chosen = 0
        return status


class WhileDoElse(Node):
    def tick(self):
        self.status = RUNNING
        condition, *rest = self.children
        status = condition.execute()
        if status == RUNNING:
            return RUNNING
        if status == SKIPPED:
            self.reset_all()
            raise Thrown
        if status == SUCCESS:
            for other in rest[1:]:
                self.reset(other)
            status = rest[0].execute()
        elif len(rest) == 2:
            self.reset(rest[0])
            status = rest[1].execute()
        if status != RUNNING:
            self.reset_all()
        return status


class Switch(Node):
    def clear(self):
        self.running = None

    def is_case(self, value, case):
        """As texts, or as what both begin with: a whole number, or else a number."""
        if value is None:
            return False
        value = f"{value:f}" if isinstance(value, float) else str(value)
        one, other = (str(self.world.enums.get(text, text)) for text in (value, case))
        wholes, numbers = (
            [re.match(form, text) for text in (one, other)] for form in (r"-?\d+", r"-?\d+(\.\d+)?")
        )
        if one == other or (all(wholes) and int(wholes[0][0]) == int(wholes[1][0])):
            return True
        return all(numbers) and float(numbers[0][0]) == float(numbers[1][0])

    def tick(self):
        *cases, chosen = self.children
        value = self.board.get(self.ports["variable"].strip("{}"))
        value = int(value) if isinstance(value, bool) else value
        for number in range(len(cases), 0, -1):
            chosen = (
                cases[number - 1] if self.is_case(value, self.ports[f"case_{number}"]) else chosen
            )
        if self.running not in (None, chosen):
            self.reset(self.running)
        status = chosen.execute()
        self.running = chosen if status == RUNNING else None
        if status in DONE:
            self.reset_all()
        return status


class Decorator(Node):
    @property
    def child(self):
        return self.children[0]

    def execute(self):
        status = super().execute()
        if self.child.status in DONE:
            self.child.status = IDLE
        return status

    def tick_child(self):
        status = self.child.execute()
        if status in DONE:
            self.reset(self.child)
        return status


WORDS = {
    "Inverter": {SUCCESS: FAILURE, FAILURE: SUCCESS},
    "ForceSuccess": {FAILURE: SUCCESS},
    "ForceFailure": {SUCCESS: FAILURE},
    "KeepRunningUntilFailure": {SUCCESS: RUNNING, SKIPPED: RUNNING},
    "SubTree": {},
}


class Translated(Decorator):
    def tick(self):
        self.status = RUNNING
        status = self.tick_child()
        return WORDS[self.tag].get(status, status)


class Again(Decorator):
    once_more, port = SUCCESS, "num_cycles"

    def clear(self):
        self.count = 0

    def is_left(self):
        return int(self.ports[self.port]) in (-1, *range(self.count + 1, 100))

    def tick(self):
        self.status = RUNNING
        while self.is_left():
            was_idle = self.child.status == IDLE
            status = self.child.execute()
            if status == RUNNING:
                return RUNNING
            self.reset(self.child)
            if status == self.once_more:
                self.count += 1
                if was_idle and self.is_left():
                    return RUNNING
                continue
            if status != SKIPPED:
                self.count = 0
            return status
        self.count = 0
        return self.once_more


class RunOnce(Decorator):
    outcome = None

    def tick(self):
        if self.outcome is not None:
            return SKIPPED if self.ports.get("then_skip", "true") == "true" else self.outcome
        self.status = RUNNING
        status = self.tick_child()
        self.outcome = status if status in DONE else None
        return status


class Delay(Decorator):
    def clear(self):
        self.since = None

    def tick(self):
        if self.since is None:
            self.since = self.world.now
            self.status = RUNNING
        if self.world.now - self.since < int(self.ports["delay_msec"]) / 1000:
            return RUNNING
        status = self.tick_child()
        if status in DONE:
            self.clear()
        return status


class Timeout(Decorator):
    def clear(self):
        self.since = None
        self.is_spent = False

    def tick(self):
        if self.since is None:
            self.since = self.world.now
            self.status = RUNNING
        if not self.is_spent and self.world.now - self.since >= int(self.ports["msec"]) / 1000:
            self.is_spent = True
            if self.child.status == RUNNING:
                self.reset(self.child)
                self.clear()
                return FAILURE
        status = self.tick_child()
        if status in DONE:
            self.clear()
        return status


class Precondition(Decorator):
    is_begun = False  # which being halted does not change

    def tick(self):
        if not self.is_begun and not self.holds(self.ports["if"]):
            return self.ports.get("else", FAILURE)
        status = self.tick_child()
        self.is_begun = status not in DONE
        return status


class Updated(Decorator):
    asked = 0

    def clear(self):
        self.goes_on = False

    def tick(self):
        if not self.goes_on and not is_updated(self):
            return SKIPPED if self.tag == "SkipUnlessUpdated" else RUNNING
        status = self.tick_child()
        self.goes_on = status == RUNNING
        return status


def is_updated(node):
    written = node.board.times_written(node.ports["entry"].strip("{}"))
    before = node.asked
    node.asked = node.asked if written is None else written
    return node.asked != before


class WasEntryUpdated(Node):
    asked = 0

    def tick(self):
        return SUCCESS if is_updated(self) else FAILURE


class SetBlackboard(Node):
    def tick(self):
        source = self.ports["value"].strip("{}")
        key = self.ports["output_key"]
        if source == self.ports["value"]:
            self.board[key] = source
            return SUCCESS
        if self.board.get(source) is None:
            self.board.setdefault(key)
            return FAILURE
        self.board[key] = self.board[source]
        return SUCCESS


class UnsetBlackboard(Node):
    def tick(self):
        self.board.unset(self.ports["key"])
        return SUCCESS


class Loop(Decorator):
    read, left = int, ()

    def clear(self):
        self.goes_on = False

    def tick(self):
        if self.status == IDLE:
            self.goes_on = False
            self.left = self.ports["queue"].split(";")
        if not self.goes_on:
            if not self.left:
                return self.ports.get("if_empty", SUCCESS)
            if "value" in self.ports:
                self.board[self.ports["value"].strip("{}")] = type(self).read(self.left[0])
            self.left = self.left[1:]
        self.status = RUNNING
        status = self.tick_child()
        self.goes_on = status == RUNNING
        return FAILURE if status == FAILURE else RUNNING


class TryCatch(Node):
    def clear(self):
        self.index = self.skipped = 0

    def tick(self):
        self.status = RUNNING
        last = len(self.children) - 1
        while self.index < last:
            status = self.children[self.index].execute()
            if status == RUNNING:
                return RUNNING
            self.skipped += status == SKIPPED
            self.index += 1
            if status == FAILURE:
                self.reset_all()
                self.index = last + 1
            elif self.index == last:
                all_skipped = self.skipped == last
                self.reset_all()
                self.clear()
                return SKIPPED if all_skipped else SUCCESS
        if self.children[-1].execute() == RUNNING:
            return RUNNING
        self.reset_all()
        self.clear()
        return FAILURE

    def halt(self):
        if self.ports.get("catch_on_halt") == "true" and self.index < len(self.children) - 1:
            for child in self.children[:-1]:
                self.reset(child)
            self.children[-1].execute()
        super().halt()


class Script(Node):
    def tick(self):
        if self.tag == "ScriptCondition":
            return SUCCESS if self.holds(self.ports["code"]) else FAILURE
        self.follow("code")
        return SUCCESS


def kind(base, **given):
    return type(base.__name__, (base,), given)


def literal(text):
    for read in (int, float):
        try:
            return read(text)
        except ValueError:
            pass
    return text


READ = {"Int": int, "Double": float, "Bool": lambda text: text in ("true", "1"), "String": str}
KINDS = {
    "Sequence": InOrder,
    "AsyncSequence": kind(InOrder, is_async=True),
    "SequenceWithMemory": kind(InOrder, is_async=True, remembers=True),
    "Fallback": kind(InOrder, goes_on=FAILURE),
    "AsyncFallback": kind(InOrder, goes_on=FAILURE, is_async=True),
    "ReactiveSequence": Reactive,
    "ReactiveFallback": kind(Reactive, goes_on=FAILURE),
    **{one.__name__: one for one in (Parallel, ParallelAll, IfThenElse, WhileDoElse, TryCatch)},
    **dict.fromkeys(("Switch2", "Switch3", "Switch4"), Switch),
    **dict.fromkeys(WORDS, Translated),
    "Repeat": Again,
    "RetryUntilSuccessful": kind(Again, once_more=FAILURE, port="num_attempts"),
    **{one.__name__: one for one in (RunOnce, Delay, Timeout, Precondition)},
    **{f"Loop{name}": kind(Loop, read=read) for name, read in READ.items()},
    **dict.fromkeys(("SkipUnlessUpdated", "WaitValueUpdate"), Updated),
    **{one.__name__: one for one in (WasEntryUpdated, SetBlackboard, UnsetBlackboard)},
    **dict.fromkeys(("Script", "ScriptCondition"), Script),
    "AlwaysSuccess": kind(Node, tick=lambda self: SUCCESS),
    "AlwaysFailure": kind(Node, tick=lambda self: FAILURE),
}


class Twin:
    """A tree of a file.

    Args:
        text: the file.
        leaves: by tag, as (kind, script).
        enums: names that scripts know.
        ports: by tag, as recorded cases say them: `p`, a whole number in, and `o`, whole numbers
            out.
    """

    def __init__(self, text, leaves, enums=(), ports=None):
        root = ElementTree.fromstring(text)
        self.trees = {one.get("ID"): one[0] for one in root if one.tag == "BehaviorTree"}
        self.world = World(leaves, dict(enums), ports or {})
        self.root = self.made(self.trees[root.get("main_tree_to_execute")], self.world.board)

    def made(self, element, board):
        for text in element.attrib.values():
            if re.fullmatch(r"\{\w+\}", text):
                board.setdefault(text[1:-1])
        children = list(element)
        inner = board
        if element.tag == "SubTree":
            children = [self.trees[element.get("ID")]]
            inner = self.board_of(element, board)
        made = [self.made(child, inner) for child in children]
        return KINDS.get(element.tag, Leaf)(
            element.tag, dict(element.attrib), made, self.world, board
        )

    def board_of(self, element, board):
        ports = {key: text for key, text in element.attrib.items() if key != "ID" and key[0] != "_"}
        keys = {
            key: key if text == "{=}" else text[1:-1]
            for key, text in ports.items()
            if text[0] == "{"
        }
        constants = {key: literal(text) for key, text in ports.items() if key not in keys}
        self.world.boards.append(
            Board(board, keys, constants, is_auto=element.get("_autoremap") == "true")
        )
        return self.world.boards[-1]

    def tick(self):
        """Tick once, as `tickExactlyOnce` does; return what happened and the outcome."""
        self.world.said.clear()
        status = self.root.execute()
        if status in DONE:
            self.root.status = IDLE
        return [*self.world.said, status]
