"""What a law holds is found, copied, and put back into another one of its kind, whatever it refers to."""

import json
import os
import pickle
from collections import deque

import numpy as np
import pytest

from controllers.qp.active_set import QP
from controllers.qp.solve import QPSolver
from models.errors import PoiseError
from models.law_state import Captured, LawState, _make, describe, restore
from models.robot_model import RobotModel
from models.types import ContactState, Mode


class Head:
    """Shared by two laws."""

    def __init__(self) -> None:
        self.angle = np.zeros(2)
        self.goal: np.ndarray | None = None


class Law:
    """Has all that laws have: memory with parts of it, slots, enums, what is made later, and a law apart."""

    def __init__(self, head: Head, other: object) -> None:
        self.memory = np.zeros(6)
        self.part = self.memory[2:4]
        self.head, self.other = head, other
        self.mode, self.payload, self.queue = Mode.OFF, b"", deque([1.0], maxlen=3)
        self.contact: ContactState | None = None
        self.named: dict[tuple[int, int], object] = {}
        self.made: np.ndarray | None = None


class Foreign(str):
    """Pickled as a call of a function that is not of this project."""

    def __reduce__(self) -> tuple[object, ...]:
        return os.system, (str(self),)


class Unknown:
    """Pickled as an object of a class that is not of this project."""

    def __reduce__(self) -> tuple[object, ...]:
        return _make, ("os:system", {})


@pytest.fixture(autouse=True)
def ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("models.law_state.PACKAGES", ("models", "planners", "controllers", "tests"))


def pair() -> tuple[Law, Law, Head]:
    head = Head()
    first = Law(head, None)
    return first, Law(head, first), head


def moved(law: LawState, into: LawState) -> None:
    """The state of one law through its file into another one."""
    data, description = describe(law, law.capture(law.memory()))
    restore(into, data, json.loads(json.dumps(description)))


def test_everything_is_put_back_and_what_is_shared_stays_one_object() -> None:
    (first, second, head), (other, another, same) = pair(), pair()
    states = LawState(first), LawState(second, (first,)), LawState(other), LawState(another, (other,))
    second.memory[:] = np.arange(6.0) / 3.0
    second.part = second.memory[::2]  # another part of the same memory
    second.mode, second.payload = Mode.WALK, b"\x01\xff"
    second.queue.extend([2.0, np.float64(0.1), -0.0])
    second.contact = ContactState(True, np.array([0.1] * 6))
    second.made = second.contact.wrench
    second.named = {(3, 4): [second.contact, (np.nan, np.inf)], (5, 6): None}
    head.angle[:], head.goal = (0.3, -0.1), np.array([1.0, 2.0])
    moved(states[0], states[2])
    moved(states[1], states[3])
    np.testing.assert_array_equal(another.memory, second.memory)
    another.memory[4] = 7.0
    assert list(another.part) == [second.part[0], second.part[1], 7.0]  # it is a part again, not a copy
    assert (another.mode, another.payload, another.queue) == (Mode.WALK, b"\x01\xff", deque([2.0, 0.1, -0.0]))
    assert another.queue.maxlen == 3 and type(another.queue[1]) is np.float64
    assert another.contact is not None and another.made is another.contact.wrench
    assert another.named[3, 4][0] is another.contact and np.isnan(another.named[3, 4][1][0])  # type: ignore[index]
    assert another.head is other.head is same and list(same.angle) == [0.3, -0.1] and list(same.goal) == [1.0, 2.0]
    assert another.other is other


def test_a_copy_is_of_its_moment() -> None:
    law = Law(Head(), None)
    state = LawState(law)
    memory = state.memory()
    law.made, law.memory[0] = np.ones(2), 1.0
    captured = state.capture(memory)
    law.made[:], law.memory[0], law.mode = 5.0, 5.0, Mode.DAMP
    law.queue.clear()
    again = Law(Head(), None)
    restore(LawState(again), *describe(state, captured))
    assert (list(again.made), again.memory[0], again.mode, list(again.queue)) == ([1.0, 1.0], 1.0, Mode.OFF, [1.0])


def test_what_cannot_be_put_back_is_named() -> None:
    law, again = Law(Head(), None), Law(Head(), None)
    state = LawState(law)
    law.named[1, 2] = iter([1])
    with pytest.raises(PoiseError, match=r"list_iterator'.* cannot be restored"):
        moved(state, LawState(again))
    for content, name in ((Foreign("true"), "posix:system"), (Unknown(), "os:system")):
        data, description = describe(state, Captured(state.memory(), pickle.dumps({".head": (("goal", content),)}), []))
        with pytest.raises(PoiseError, match=f"'{name}', which is not"):
            restore(LawState(again), data, description)
    description["arrays"] = description["arrays"][1:]
    with pytest.raises(PoiseError, match="another version"):
        restore(LawState(again), data, description)


def test_active_rows_of_a_solver_move(g1: RobotModel) -> None:
    solvers, rows = [QPSolver(1e-6, 100, 1e-6) for _ in range(2)], np.eye(4)
    qp = QP(rows, np.full(4, -3.0), rows, -np.ones(4), np.array([9.0, 9.0, 1.0, 9.0]), rows[0] > 2.0)
    for solver in solvers:
        solver.prepare(qp)
    states = [LawState(each) for each in solvers]
    solvers[0].solve(qp)
    moved(*states)
    np.testing.assert_array_equal(solvers[1]._workspaces[4, 4].marks, [False, False, True, False])
