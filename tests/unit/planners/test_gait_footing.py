"""The part of a sole that bears load: the line that it turns over, an edge or its rim."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from msgspec import structs

from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import RobotState
from planners.gait.config import GaitConfig
from planners.gait.footing import Footing
from planners.gait.footsteps import Foothold
from planners.gait.measurement import LOADED, GaitMeasurement, Ground, Measurement
from planners.gait.planner import GaitPlanner
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitPhase
from tests.gaits import DT, in_single_support, on_one_foot
from tests.support import standing

CONFIG = default_config(GaitConfig, "planners", "gait").footing
TURN = 4.0 * CONFIG.still  # [rad/s]
COP = 0.01  # of the soles of a robot that turns over, to the left [m]
WHILE = round(1.2 * CONFIG.tilted / TURN / DT)  # ticks in which it turns far enough


class Watched:
    """The footing of a G1, tick by tick."""

    def __init__(self) -> None:
        self._law = Footing(RobotModel.load("g1"), CONFIG)
        self.reset()

    def reset(self) -> None:
        self.state = self._law.whole()

    @property
    def areas(self) -> np.ndarray:
        return self.state.areas

    def update(self, seen: Measurement, swinging: int | None = None, *, urgent: bool = False) -> None:
        self.state = self._law.update(self.state, seen, swinging, np.zeros(2), DT, urgent=urgent)


def measured(turning: tuple[float, float], cop: tuple[float, float], load: float = 0.6) -> Measurement:
    """The left sole turns about its x and y [rad/s], its CoP at an edge [m]; the right one lies still."""
    flat, sole = np.zeros(3), Foothold(0.0, 0.0, 0.0)
    turnings, cops = np.array([turning, (0.0, 0.0)]), np.array([cop, (0.0, 0.0)])
    forces = np.array([(0.0, 0.0, load), (0.0, 0.0, 0.4)])
    return Measurement(flat, flat, (sole, sole), np.zeros((2, 2)), turnings, cops, (load, 0.4), (True, True), forces)


@pytest.fixture
def footing() -> Watched:
    return Watched()


def turn(footing: Watched, seen: Measurement, ticks: int = WHILE) -> np.ndarray:
    for _ in range(ticks):
        footing.update(seen)
    return footing.areas[0].copy()


@pytest.mark.parametrize(
    ("turning", "axis"),
    [((TURN, 0.0), 1), ((-TURN, 0.0), 1), ((0.0, -TURN), 0), ((0.0, TURN), 0)],
    ids=["right side down", "left side down", "heel down", "toe down"],
)
@pytest.mark.parametrize("edge", [(0.03, 0.004), (-0.03, 0.012), (0.101, -0.017)], ids=str)
def test_a_sole_that_turns_over_an_edge_bears_on_it_alone(
    footing: Watched, turning: tuple[float, float], axis: int, edge: tuple[float, float]
) -> None:
    whole = footing.areas.copy()
    low, high, *others = turn(footing, measured(turning, edge))[[2 * axis, 2 * axis + 1, 2 - 2 * axis, 3 - 2 * axis]]
    assert low == high
    assert low == pytest.approx(edge[axis], abs=0.5 * CONFIG.grain + 1e-9)
    np.testing.assert_array_equal(others, whole[0, [2 - 2 * axis, 3 - 2 * axis]])
    np.testing.assert_array_equal(footing.areas[1], whole[1])


def test_a_sole_that_lies_down_or_bears_nothing_is_whole(footing: Watched) -> None:
    whole = footing.areas.copy()
    turn(footing, measured((TURN, 0.0), (0.0, 0.01)), round(0.9 * CONFIG.tilted / TURN / DT))  # it has lain down
    turn(footing, measured((0.2 * CONFIG.still, 0.0), (0.0, 0.01)), 4 * WHILE)
    np.testing.assert_array_equal(footing.areas, whole)
    footing.reset()
    turn(footing, measured((TURN, 0.0), (0.0, 0.01), load=0.5 * LOADED))
    np.testing.assert_array_equal(footing.areas, whole)


@pytest.mark.parametrize("line", [0.01, None], ids=["edge", "rim"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sole_that_lies_still_has_found_ground(footing: Watched, line: float | None, sign: float) -> None:
    """It turned onto a lower tile, or the slope of the ground is not the expected one."""
    whole = footing.areas.copy()
    cop = (0.0, whole[0, 3] if line is None else line)
    angle = 1.5 * CONFIG.tilted
    turned = turn(footing, measured((sign * TURN, 0.0), cop), round(angle / TURN / DT))
    assert turned[2] == turned[3] == pytest.approx(cop[1], abs=0.5 * CONFIG.grain)
    still = measured((0.0, 0.0), cop)
    briefly = turn(footing, still, round(0.3 * CONFIG.rest_time / DT))  # as where a rocking sole turns back
    np.testing.assert_array_equal(briefly, turned)
    np.testing.assert_array_equal(turn(footing, still, round(2.0 * CONFIG.rest_time / DT)), whole[0])
    again = turn(footing, measured((1.1 * sign * CONFIG.still, 0.0), cop), round(CONFIG.tilted / CONFIG.still / DT))
    np.testing.assert_array_equal(again, turned)


def test_a_sole_that_tipped_over_its_rim_bears_on_it_until_it_lies_flat(footing: Watched) -> None:
    whole = footing.areas.copy()
    rim = (0.0, whole[0, 3])
    tipped = turn(footing, measured((-TURN, 0.0), rim), round(1.2 * CONFIG.tilted / TURN / DT))
    np.testing.assert_array_equal(tipped, [*whole[0, :2], whole[0, 3], whole[0, 3]])
    np.testing.assert_array_equal(footing.areas[1], whole[1])
    back = turn(footing, measured((TURN, 0.0), rim), round(0.5 * CONFIG.tilted / TURN / DT))
    np.testing.assert_array_equal(back, tipped)
    flat = turn(footing, measured((TURN, 0.0), rim), round(0.3 * CONFIG.tilted / TURN / DT))
    np.testing.assert_array_equal(flat, whole[0])


def test_a_sole_that_tipped_over_its_rim_is_whole_once_its_cop_leaves_the_rim(footing: Watched) -> None:
    whole = footing.areas.copy()
    tipped = turn(footing, measured((-TURN, 0.0), (0.0, whole[0, 3])), 2 * WHILE)
    assert tipped[2] == tipped[3]
    footing.update(measured((0.0, 0.0), (0.0, whole[0, 3] - 1.5 * CONFIG.edge)))
    np.testing.assert_array_equal(footing.areas, whole)


@pytest.mark.parametrize(("tilt", "cop", "edge"), [((0.1, 0.0), -0.05, -0.05), ((-0.1, 0.0), 0.12, 0.12)])
def test_a_foot_that_lands_on_its_heel_or_toe_bears_on_it(
    footing: Watched, tilt: tuple[float, float], cop: float, edge: float
) -> None:
    """Turned by a quarter: its toe points along y of W, to which it rises."""
    sole, cops = Foothold(0.0, 0.0, 0.5 * np.pi), (cop, 0.0)
    seen = structs.replace(measured((0.0, 0.0), cops), soles=(sole, sole), tilts=np.array([tilt[::-1], (0.0, 0.0)]))
    for urgent in (False, True):
        footing.update(seen, 0)
        footing.update(seen, urgent=urgent)
        np.testing.assert_array_equal(footing.areas[0, :2], edge)
    down = -np.sign(edge) * TURN  # the raised side; about y, a positive rotation lowers the front
    ticks = round(0.8 * abs(tilt[0]) / TURN / DT)
    away = turn(footing, structs.replace(seen, turning=np.array([(0.0, -down), (0.0, 0.0)])), ticks)
    np.testing.assert_array_equal(away[:2], edge)
    flat = turn(footing, structs.replace(seen, turning=np.array([(0.0, down), (0.0, 0.0)])), 2 * ticks + 5)
    assert flat[0] < flat[1]


def test_a_sole_that_rolls_as_it_lands_is_whole(footing: Watched) -> None:
    """Its CoP wanders meanwhile: there is no edge."""
    whole = footing.areas.copy()
    for tick in range(2 * WHILE):
        wanders = -0.02 + 0.04 * tick / (2 * WHILE)
        footing.update(measured((TURN, 0.0), (0.0, wanders)))
    np.testing.assert_array_equal(footing.areas, whole)


def test_a_foot_that_has_been_lifted_lands_on_its_whole_sole(footing: Watched) -> None:
    whole = footing.areas.copy()
    seen = measured((TURN, 0.0), (0.0, 0.01))
    assert (turn(footing, seen) != whole[0]).any()
    footing.update(seen, 0)
    np.testing.assert_array_equal(footing.areas, whole)


def test_turning_and_centre_of_pressure_are_those_of_the_sole() -> None:
    """A robot that rolls and pitches about its left sole, which it presses with its front left part."""
    model = RobotModel.load("g1")
    v = np.zeros(model.nv)
    v[3:6] = 0.7, -0.4, 0.1
    state = standing(model, v=v, shares=(1.0, 0.0))
    load = state.contacts[0].wrench[2]
    state.contacts[0].wrench[3:5] = 0.02 * load, -0.05 * load
    seen = GaitMeasurement(model).measure(state)
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, state.q)
    sole = data.oMf[model.feet[0].frame_id].rotation
    base = data.oMi[1].rotation
    np.testing.assert_allclose(seen.turning[0], (sole.T @ base @ v[3:6])[:2], atol=1e-9)
    np.testing.assert_allclose(seen.cops[0], [0.05, 0.02])
    np.testing.assert_allclose(seen.cops[1], 0.0)


def test_forces_on_a_turned_and_tilted_sole_are_those_in_the_world() -> None:
    model = RobotModel.load("g1")
    q = model.standing_configuration()
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.2, -0.3, 1.1)).coeffs()
    state = standing(model, q=q, shares=(1.0, 0.0))
    state.contacts[0].wrench[:2] = 30.0, -20.0
    seen, data = GaitMeasurement(model).measure(state), model.data()
    pin.framesForwardKinematics(model.pin, data, q)
    world = data.oMf[model.feet[0].frame_id].rotation @ state.contacts[0].wrench[:3]
    np.testing.assert_allclose(seen.forces, [world / (model.mass * GRAVITY), np.zeros(3)], atol=1e-12)
    assert seen.upright(0) and not seen.upright(1)


@pytest.mark.parametrize("side", range(4), ids=["heel", "toe", "right rim", "left rim"])
def test_a_sole_on_its_rim_is_turned_towards_the_ground(side: int) -> None:
    """From where it is; on an edge across it, it keeps the expected slope."""
    model, axis = RobotModel.load("g1"), side // 2
    measurement, state = GaitMeasurement(model, CONFIG.lie_angle), standing(model)
    areas, slope = np.array([foot.rectangle for foot in model.feet]), np.array([0.02, 0.03])
    areas[0, 2 * axis : 2 * axis + 2] = areas[0, side]
    present = measurement.measure(state).tilts
    seen = measurement.measure(state, ground=Ground(areas, slope)).tilts
    middle = areas[0, side]  # the sole's height at the rim does not change, and that of its middle sinks
    assert (seen[0] - present[0])[axis] * -middle == pytest.approx(-abs(middle) * np.tan(CONFIG.lie_angle), abs=1e-9)
    np.testing.assert_array_equal(seen[1], present[1])
    for edge in (0.01, 0.0):  # the latter below the ankle
        areas[0, 2 * axis : 2 * axis + 2] = edge
        np.testing.assert_array_equal(measurement.measure(state, ground=Ground(areas, slope)).tilts[0], slope)


@pytest.mark.parametrize("line", ["heel", "left rim", "edge"])
def test_the_place_of_a_sole_on_a_line_is_where_it_would_lie_flat(line: str) -> None:
    model = RobotModel.load("g1")
    q = model.standing_configuration()
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.1, -0.2, 0.7)).coeffs()
    measurement, state = GaitMeasurement(model), standing(model, q=q)
    areas = np.array([foot.rectangle for foot in model.feet])
    x_min, _, _, y_max = areas[0]
    axis, at = {"heel": (0, x_min), "left rim": (1, y_max), "edge": (0, 0.03)}[line]
    areas[0, 2 * axis : 2 * axis + 2] = at
    whole, seen = measurement.measure(state), measurement.measure(state, ground=Ground(areas, np.zeros(2)))
    data, point = model.data(), np.zeros(3)
    point[axis] = at
    pin.framesForwardKinematics(model.pin, data, q)
    sole, lies = data.oMf[model.feet[0].frame_id], seen.soles[0]
    np.testing.assert_allclose((*lies.moved(*point[:2]), lies.z), sole.act(point), atol=1e-12)
    assert seen.soles[1] == whole.soles[1]


def test_a_sole_that_falls_back_lies_flat_and_turns_over_the_same_edge(footing: Watched) -> None:
    whole = footing.areas.copy()
    cut = turn(footing, measured((TURN, 0.0), (0.0, 0.01)))
    flat = turn(footing, measured((-TURN, 0.0), (0.0, 0.01)))
    np.testing.assert_array_equal(flat, whole[0])
    np.testing.assert_array_equal(turn(footing, measured((-TURN, 0.0), (0.0, 0.01))), cut)


def urgent_from(model: RobotModel, error: float) -> GaitConfig:
    """The gait, whose steps are urgent from this error of the DCM [m]."""
    config = load_gait_config(model)
    return replace(config, adjustment=replace(config.adjustment, urgent=error))


def turning_over(planner: GaitPlanner, sideways: float = 0.0) -> RobotState:
    """The robot turns to its right about its CoM, which moves sideways [m/s]; its soles bear left of their middles."""
    model = planner.model
    state = standing(model, shares=on_one_foot(planner.stance) if planner.phase is GaitPhase.SINGLE else (0.5, 0.5))
    data, rotation = model.data(), pin.Quaternion(state.q[3:7]).matrix()
    state.v[3:6] = rotation.T @ [TURN, 0.0, 0.0]
    pin.centerOfMass(model.pin, data, state.q, state.v)
    state.v[:3] = rotation.T @ (np.array([0.0, sideways, 0.0]) - data.vcom[0])
    for contact in state.contacts:
        contact.wrench[3] = COP * contact.wrench[2]
    return state


def test_a_gait_uses_what_bears_and_swings_a_whole_sole(g1: RobotModel) -> None:
    """Both soles turn while the weight shifts; then the right one lifts, and the left one goes on turning."""
    whole = np.array([foot.rectangle for foot in g1.feet])
    planner = GaitPlanner(g1, urgent_from(g1, error=1.0))
    planner.reset(standing(g1))
    planner.set_velocity(0.0, -0.1, 0.0)
    while planner.phase is not GaitPhase.SINGLE:
        reference = planner.step(turning_over(planner), DT)
    assert planner.stance == 0 and reference.sole_areas is not None
    assert reference.sole_areas[:, 2:] == pytest.approx(COP, abs=0.5 * CONFIG.grain + 1e-9)
    np.testing.assert_array_equal(reference.sole_areas[:, :2], whole[:, :2])
    reference = planner.step(turning_over(planner), DT)
    assert planner.phase is GaitPhase.SINGLE and reference.sole_areas is not None
    assert reference.sole_areas[0, 2:] == pytest.approx(COP, abs=0.5 * CONFIG.grain + 1e-9)
    np.testing.assert_array_equal(reference.sole_areas[1], whole[1])


@pytest.mark.parametrize("urgent", [True, False])
def test_an_urgent_step_uses_the_whole_sole_that_turns(g1: RobotModel, urgent: bool) -> None:
    planner = in_single_support(g1, urgent_from(g1, error=0.01 if urgent else 1.0), stance=0)
    for _ in range(40):
        reference = planner.step(turning_over(planner, sideways=-1.0), DT)
    assert planner.phase is GaitPhase.SINGLE and reference.sole_areas is not None
    assert (reference.sole_areas[0, 2] == g1.feet[0].rectangle[2]) == urgent
