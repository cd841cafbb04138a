"""Conversions between Pinocchio and MuJoCo, and joint order: properties that hold for every state."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from models.mujoco_model import MujocoModel, build_mujoco, mujoco_to_pin, pin_to_mujoco
from models.robot_model import RobotModel

_reals = st.floats(-50.0, 50.0, allow_nan=False, width=64)


@cache
def _pair(name: str) -> tuple[RobotModel, MujocoModel]:
    model = RobotModel.load(name)
    return model, build_mujoco(model)


@st.composite
def _states(draw: st.DrawFn, name: str) -> tuple[np.ndarray, np.ndarray]:
    model, _ = _pair(name)
    q = draw(arrays(np.float64, model.nq, elements=_reals))
    quaternion = draw(
        arrays(np.float64, 4, elements=st.floats(-1.0, 1.0, width=64)).filter(lambda x: np.linalg.norm(x) > 0.1)
    )
    q[3:7] = quaternion / np.linalg.norm(quaternion)
    return q, draw(arrays(np.float64, model.nv, elements=_reals))


@pytest.mark.parametrize("name", ["g1", "talos"])
@given(data=st.data())
@settings(deadline=None)
def test_round_trip(name: str, data: st.DataObject) -> None:
    model, mj = _pair(name)
    q, v = data.draw(_states(name))
    q_before, v_before = q.copy(), v.copy()
    q_back, v_back = mujoco_to_pin(model, mj, *pin_to_mujoco(model, mj, q, v))
    np.testing.assert_array_equal(q_back, q)
    np.testing.assert_allclose(v_back, v, atol=1e-11)
    np.testing.assert_array_equal(q, q_before)
    np.testing.assert_array_equal(v, v_before)


@pytest.mark.parametrize("name", ["g1", "talos"])
@given(data=st.data())
@settings(deadline=None)
def test_speeds_are_kept(name: str, data: st.DataObject) -> None:
    """The free joint's linear velocity is rotated, not changed; the rest is moved, not changed."""
    model, mj = _pair(name)
    q, v = data.draw(_states(name))
    qpos, qvel = pin_to_mujoco(model, mj, q, v)
    assert np.linalg.norm(qvel[:3]) == pytest.approx(np.linalg.norm(v[:3]), abs=1e-10)
    np.testing.assert_array_equal(qvel[3:6], v[3:6])
    assert sorted(qpos[7:]) == sorted(q[7:]) and sorted(qvel[6:]) == sorted(v[6:])
    assert qpos[3] == q[6]


@pytest.mark.parametrize("name", ["g1", "talos"])
@given(data=st.data())
@settings(deadline=None)
def test_reorder_is_indifferent_to_the_order_given(name: str, data: st.DataObject) -> None:
    model, _ = _pair(name)
    values = data.draw(arrays(np.float64, model.nj, elements=_reals))
    order = data.draw(st.permutations(range(model.nj)))
    result = model.reorder([model.joint_names[i] for i in order], values[list(order)])
    np.testing.assert_array_equal(result, values)
