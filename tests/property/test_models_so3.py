"""Properties of the rotation kernels."""

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

from models.numerics.so3 import (
    exponential,
    left_jacobian,
    logarithm,
    orthonormalise,
    to_quaternion,
    turn_noise,
)

coordinate = st.floats(-1.0, 1.0, allow_subnormal=False)
direction = st.tuples(coordinate, coordinate, coordinate).filter(lambda v: np.linalg.norm(v) > 1e-3)
# Down to angles where the series take over, up to a half turn.
angle = st.one_of(st.floats(0.0, np.pi - 1e-6), st.floats(1e-12, 1e-3), st.just(0.0))


def vector(axis: tuple[float, float, float], length: float) -> np.ndarray:
    return np.array(axis) / np.linalg.norm(axis) * length


def exp(phi: np.ndarray) -> np.ndarray:
    out = np.empty((3, 3))
    exponential(phi, out)
    return out


@settings(max_examples=300, deadline=None)
@given(direction, angle)
def test_exponential_is_a_rotation_and_the_logarithm_undoes_it(axis: tuple[float, float, float], size: float) -> None:
    phi = vector(axis, size)
    rotation = exp(phi)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, pin.exp3(phi), atol=1e-12)
    back = np.empty(3)
    logarithm(rotation, back)
    np.testing.assert_allclose(back, phi, atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(direction, angle, direction)
def test_left_jacobian_is_the_derivative(
    axis: tuple[float, float, float], size: float, other: tuple[float, float, float]
) -> None:
    phi, change = vector(axis, size), vector(other, 1e-6)
    jacobian = np.empty((3, 3))
    left_jacobian(phi, jacobian)
    difference = pin.log3(exp(phi + change) @ exp(phi - change).T) / 2.0
    np.testing.assert_allclose(jacobian @ change, difference, atol=1e-6 * 1e-4)


@settings(max_examples=200, deadline=None)
@given(direction, st.floats(0.0, 2.0 * np.pi))
def test_quaternion_is_unit_with_positive_w_and_the_same_rotation(
    axis: tuple[float, float, float], size: float
) -> None:
    rotation = exp(vector(axis, size))
    quaternion = np.empty(4)
    to_quaternion(rotation, quaternion)
    assert abs(np.linalg.norm(quaternion) - 1.0) < 1e-14
    assert quaternion[3] >= 0.0
    np.testing.assert_allclose(pin.Quaternion(quaternion).toRotationMatrix(), rotation, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(direction, angle, direction)
def test_orthonormalising_repairs_rounding_and_leaves_rotations(
    axis: tuple[float, float, float], size: float, noise: tuple[float, float, float]
) -> None:
    rotation = exp(vector(axis, size))
    damaged = rotation + 1e-7 * np.outer(noise, noise[::-1])
    orthonormalise(damaged)
    np.testing.assert_allclose(damaged.T @ damaged, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(damaged, rotation, atol=1e-6)


near_half_turn = st.floats(0.0, 1e-4).map(lambda gap: np.pi - gap)


@settings(max_examples=200, deadline=None)
@given(direction, near_half_turn)
def test_logarithm_holds_up_to_a_half_turn(axis: tuple[float, float, float], size: float) -> None:
    """Where the sign of the axis is undetermined the rotation is still the same."""
    rotation, back = exp(vector(axis, size)), np.empty(3)
    logarithm(rotation, back)
    np.testing.assert_allclose(exp(back), rotation, atol=1e-9)
    assert np.linalg.norm(back) <= np.pi + 1e-12


@settings(max_examples=200, deadline=None)
@given(direction, st.one_of(angle, near_half_turn), direction, angle)
def test_adjoint_moves_a_rotation_vector_through_the_exponential(
    axis: tuple[float, float, float], size: float, other: tuple[float, float, float], turn: float
) -> None:
    """``R Exp(phi) R' = Exp(R phi)``: the adjoint of SO(3) is the rotation itself."""
    rotation, phi = exp(vector(axis, size)), vector(other, turn)
    np.testing.assert_allclose(rotation @ exp(phi) @ rotation.T, exp(rotation @ phi), atol=1e-12)


@settings(max_examples=200, deadline=None)
@given(direction, st.one_of(angle, near_half_turn))
def test_left_jacobian_against_right_one_and_exponential(axis: tuple[float, float, float], size: float) -> None:
    """``J_l(phi) = Exp(phi) J_l(-phi)`` (the right Jacobian), ``Exp(phi) = I + [phi]x J_l``, and ``J_l phi = phi``."""
    phi = vector(axis, size)
    left, right = np.empty((3, 3)), np.empty((3, 3))
    left_jacobian(phi, left)
    left_jacobian(-phi, right)
    np.testing.assert_allclose(left, exp(phi) @ right, atol=1e-10)
    np.testing.assert_allclose(right, pin.Jexp3(phi), atol=1e-8)
    np.testing.assert_allclose(np.eye(3) + pin.skew(phi) @ left, exp(phi), atol=1e-10)
    np.testing.assert_allclose(left @ phi, phi, atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(st.floats(1e-7, 1e-3), direction)
def test_series_and_closed_forms_meet(size: float, axis: tuple[float, float, float]) -> None:
    """Across the angles at which they take over, neighbours differ by no more than the angles do."""
    near, far = np.empty((3, 3)), np.empty((3, 3))
    phi = vector(axis, size)
    left_jacobian(phi, near)
    left_jacobian(1.001 * phi, far)
    assert np.abs(near - far).max() <= 1e-3 * size + 1e-11
    assert np.abs(exp(phi) - exp(1.001 * phi)).max() <= 2e-3 * size + 1e-11


@settings(max_examples=100, deadline=None)
@given(direction, angle, st.integers(0, 2**32 - 1))
def test_noise_turns_with_the_frame(axis: tuple[float, float, float], size: float, seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    noise, out = root @ root.T, np.empty((6, 6))
    rotation = exp(vector(axis, size))
    turn_noise(rotation, noise, out)
    both = np.kron(np.eye(2), rotation)
    np.testing.assert_allclose(out, both @ noise @ both.T, atol=1e-12 * np.trace(noise))
