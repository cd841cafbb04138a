import ctypes.util
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import models
from bridge.analysis.stability import GRAVITY, LEAST_HEIGHT, analyse, balance, stability_figures
from bridge.record.recording import Recording
from bridge.record.render import draw, frame_times, render_filmstrip
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import ContactState, RobotState
from tests.support import standing


def _standing(model: RobotModel, t: float, velocity: tuple[float, float] = (0.0, 0.0)) -> RobotState:
    """Standing at rest or drifting, with the weight borne where the CoM projects on the floor."""
    q = model.standing_configuration()
    v = np.zeros(model.nv)
    v[:2] = pin.Quaternion(q[3:7]).matrix()[:2, :2].T @ velocity
    data = model.data()
    com = pin.centerOfMass(model.pin, data, q).copy()
    pin.framesForwardKinematics(model.pin, data, q)
    contacts = []
    for foot in model.feet:
        arm = com - data.oMf[foot.frame_id].translation
        force = np.array([0.0, 0.0, 0.5 * model.mass * GRAVITY])
        wrench = pin.Force(force, np.cross([arm[0], arm[1], 0.0], force))
        aligned = pin.SE3(data.oMf[foot.frame_id].rotation, np.zeros(3))
        contacts.append(ContactState(True, aligned.actInv(wrench).vector))
    return RobotState(t, q, v, np.zeros(model.nj), (contacts[0], contacts[1]))


def _recording(robot: str, states: Sequence[RobotState], events: tuple[tuple[float, str], ...] = ()) -> Recording:
    columns = {name: np.array([getattr(state, name) for state in states]) for name in ("t", "q", "v", "tau")}
    wrenches = np.array([[contact.wrench for contact in state.contacts] for state in states])
    return Recording(robot, wrenches=wrenches, events=events, **columns)


def test_a_recording_survives_its_file(g1: RobotModel, tmp_path: Path) -> None:
    recording = _recording("g1", [_standing(g1, 0.1 * k) for k in range(11)], ((0.5, "wave"),))
    recording.save(tmp_path / "run.npz")
    again = Recording.load(tmp_path / "run.npz")
    assert again.events == ((0.5, "wave"),) and again.robot == "g1"
    for name in ("t", "q", "v", "tau", "wrenches"):
        assert np.array_equal(getattr(again, name), getattr(recording, name))


def test_what_is_not_a_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.npz").write_bytes(b"no archive")
    with pytest.raises(PoiseError, match=r"run\.npz"):
        Recording.load(tmp_path / "run.npz")


def test_at_rest_com_dcm_and_zmp_coincide(robot: RobotModel) -> None:
    states = [_standing(robot, 0.5 * k) for k in range(5)]
    stability = analyse(robot, _recording(robot.name, states))
    assert stability.dcm == pytest.approx(stability.com[:, :2], abs=1e-12)
    assert stability.zmp == pytest.approx(stability.com[:, :2], abs=1e-9)
    assert np.all(stability.margin > 0.02)
    figures = stability_figures(stability)
    assert figures["com_drift_m"] == pytest.approx(0.0, abs=1e-12)
    assert figures["sole_motion_max_m"] == 0.0


def test_a_moving_com_leads_the_dcm_and_takes_margin(g1: RobotModel) -> None:
    states = [_standing(g1, 0.5 * k, velocity=(0.1, 0.0) if k == 4 else (0.0, 0.0)) for k in range(5)]
    stability = analyse(g1, _recording("g1", states))
    omega = np.sqrt(GRAVITY / stability.com[4, 2])
    assert stability.dcm[4] - stability.com[4, :2] == pytest.approx([0.1 / omega, 0.0], abs=1e-9)
    assert stability_figures(stability)["dcm_excursion_max_m"] == pytest.approx(0.1 / omega, rel=1e-6)
    assert stability.margin[4] < stability.margin[0]


def test_without_a_loaded_foot_there_is_no_margin(g1: RobotModel) -> None:
    states = [standing(g1, shares=(0.0, 0.0))]
    stability = analyse(g1, _recording("g1", states))
    assert np.isnan(stability.margin[0]) and np.isnan(stability.zmp[0]).all()
    assert np.isnan(stability_figures(stability)["capture_margin_min_m"])


def test_the_centre_of_pressure_is_where_the_floor_is(g1: RobotModel) -> None:
    """Forces that pull sideways have no moment about the point of the floor where they act, however high that lies."""
    state = _standing(g1, 0.0)
    data = g1.data()
    flat = balance(g1, data, state.q, state.v, np.zeros((2, 6)))
    assert np.isnan(flat.cop).all()
    force, raised = np.array([30.0, -40.0, 200.0]), state.q.copy()
    raised[2] += 0.5
    point = np.array([0.03, 0.01, 0.0])  # in each sole
    wrench = np.concatenate([force, np.cross(point, force)])
    found = balance(g1, data, raised, state.v, [wrench, wrench])
    assert found.cop == pytest.approx(flat.soles.mean(axis=0)[:2] + point[:2], abs=1e-9)
    assert found.corners[:, :, 2] == pytest.approx(np.full((2, 4), flat.soles[0, 2] + 0.5), abs=1e-9)
    assert found.tilts == pytest.approx([0.0, 0.0], abs=1e-6)
    assert found.dcm == pytest.approx(flat.dcm)


def test_a_robot_that_lies_on_the_floor_still_has_a_dcm(g1: RobotModel) -> None:
    state = _standing(g1, 0.0)
    q = state.q.copy()
    q[3:7] = 0.0, np.sin(0.4 * np.pi), 0.0, np.cos(0.4 * np.pi)  # pitched so far that the feet are highest
    v = np.zeros(g1.nv)
    v[0] = 1.0
    found = balance(g1, g1.data(), q, v, np.zeros((2, 6)))
    assert found.com[2] < found.soles[:, 2].min() + LEAST_HEIGHT
    assert found.dcm - found.com[:2] == pytest.approx(found.com_velocity[:2] / np.sqrt(GRAVITY / LEAST_HEIGHT))


def test_film_strip_shows_the_height_of_every_part(g1: RobotModel) -> None:
    state = _standing(g1, 0.0)
    t = np.linspace(0.0, 10.0, 101)
    q = np.tile(state.q, (len(t), 1))
    q[20:40, 20] += np.hanning(20)  # an arm, highest about t = 3
    q[60:70, 2] -= 0.1 * np.hanning(10)  # the pelvis, lowest about t = 6.5
    rows = len(t)
    events = ((1.0, "wave"), (5.0, "wave done"), (6.0, "push"))
    recording = Recording("g1", t, q, np.zeros((rows, g1.nv)), np.zeros((rows, g1.nj)), np.zeros((rows, 2, 6)), events)
    for count in (4, 6, 8):
        times = frame_times(recording, count)
        assert len(times) == count and times == sorted(times)
        assert times[0] == 0.0 and times[-1] == 10.0
        assert any(2.8 < time < 3.2 for time in times) and any(6.3 < time < 6.7 for time in times)


@pytest.mark.long
@pytest.mark.skipif(
    ctypes.util.find_library("EGL") is None, reason="no EGL; Debian and Ubuntu: sudo apt install libegl1"
)
def test_a_film_strip_of_a_robot_that_is_known_by_its_file_alone(
    g1: RobotModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packaged = Path(models.__file__).parent / "robots" / "g1.yaml"
    profile = tmp_path / "mine.yaml"
    profile.write_text(packaged.read_text().replace("name: g1", "name: mine"))
    recording = _recording("mine", [_standing(g1, 0.05 * k) for k in range(3)])
    recording.save(tmp_path / "run.npz")
    picture = tmp_path / "strip.png"
    assert "mine" in render_filmstrip(tmp_path / "run.npz", picture) and not picture.exists()
    assert render_filmstrip(tmp_path / "run.npz", picture, str(profile)) == "" and picture.is_file()
    monkeypatch.setattr("bridge.record.render.FRAME_SIZE", (150, 240))
    monkeypatch.setattr("bridge.record.render.frame_times", lambda recording: [recording.t[0], recording.t[-1]])
    later = _recording("mine", [_standing(g1, 1.0 + 0.05 * k) for k in range(3)])
    drawn = []
    for number, each in enumerate((recording, recording, later)):
        file = tmp_path / f"{number}.png"
        draw([each], file, str(profile))
        drawn.append(file.read_bytes())
    assert drawn[0] == drawn[1] != drawn[2]  # the labels are the times of the recording
