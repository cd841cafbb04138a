"""``poise check-robot``: propose a profile for a URDF or MJCF, try it in the closed loop, and report errors."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from pydantic.dataclasses import dataclass as config_dataclass
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Fraction, Positive, default_config
from models.errors import ConfigError, PoiseError
from models.mujoco_model import build_mujoco
from models.proposal.config import ProposalConfig
from models.proposal.profile_text import write_proposal
from models.proposal.propose import Proposal, propose
from models.robot_model import RobotModel
from models.types import CommandReply, Mode
from planners.gait.scaling import load_gait_config
from planners.gait.strength import leg_limits
from planners.motion import MotionPlanner
from planners.whole_body_ik import arms


@config_dataclass(frozen=True, slots=True, config=STRICT)
class TrialConfig:
    """Schema of ``bridge/config/check_robot.yaml``; units are given there."""

    stand_time: Positive
    pause: Positive
    walk_speed: Fraction
    walk_time: Positive
    stop_time: Positive
    drift_max: Positive
    push: Positive
    push_time: Positive
    push_pause: Positive
    hand_min: Positive
    squat_min: Positive
    stride_min: Positive
    at_limit: Fraction


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of one trial; ``detail`` holds the figures, or the cause of the failure."""

    name: str
    passed: bool
    detail: str


class Trials:
    """Runs the trials in one loop, and in a new one after a fall; ``seed`` is the seed of the sensor noise."""

    def __init__(self, model: RobotModel, config: TrialConfig, seed: int = 0) -> None:
        self._model, self._config, self._seed = model, config, seed
        self._data = model.data()
        self._height = float(pin.centerOfMass(model.pin, self._data, model.standing_configuration())[2])
        self._loop: ClosedLoop | None = None

    @property
    def limits(self) -> list[str]:
        """Limits on the walk of the robot, each with its value."""
        gait = load_gait_config(self._model)
        velocity, texts = gait.velocity, {"crouch": f"{100.0 * gait.pace.slow.crouch:.1f} cm"}
        texts |= {name: f"{getattr(velocity, name):.2f} m/s" for name in ("forward", "backward", "lateral")}
        texts["turn"] = f"{velocity.turn:.2f} rad/s"
        causes: dict[str, list[str]] = {}
        for name, cause in leg_limits(self._model, gait).items():
            causes.setdefault(cause, []).append(f"{name} {texts[name]}")
        return [f"the walk is limited by {cause}: {', '.join(limited)}" for cause, limited in causes.items()]

    def run(self) -> list[Trial]:
        """Stand, squat, wave with an arm, walk, take pushes; stops when the robot cannot stand."""
        trials = [self._try("stand", self._stand)]
        if trials[0].passed:
            wave = [self._try("wave", self._wave)] if arms(self._model) else []
            trials += [
                self._try("squat", self._squat),
                *wave,
                self._try("walk", self._walk),
                self._try("push", self._push),
            ]
        return trials

    def _try(self, name: str, trial: Callable[[ClosedLoop], tuple[bool, str]]) -> Trial:
        try:
            if self._loop is None or not self._standing(self._loop):
                self._loop = ClosedLoop(self._model, seed=self._seed)
            else:
                self._loop.log.clear()
            return Trial(name, *trial(self._loop))
        except PoiseError as error:
            return Trial(name, False, str(error))

    def _stand(self, loop: ClosedLoop) -> tuple[bool, str]:
        start = loop.plant.com.copy()
        loop.run(self._config.stand_time)
        drift = float(np.linalg.norm((loop.plant.com - start)[:2]))
        if not self._standing(loop) or drift > self._config.drift_max:
            return False, self._why(loop, f"the CoM moved by {1e3 * drift:.1f} mm")
        text = (
            f"{self._config.stand_time:g} s: CoM drift {1e3 * drift:.1f} mm, slip {1e3 * loop.foot_slip.max():.2f} mm"
        )
        return True, f"{text}, {self._effort(loop)}"

    def _squat(self, loop: ClosedLoop) -> tuple[bool, str]:
        start = float(loop.truth.q[2])
        reduced = self._move(loop, "squat")
        sunk = start - float(loop.log.true_q[:, 2].min())
        text = f"pelvis sank {100.0 * sunk:.1f} cm{reduced}, {self._effort(loop)}"
        return sunk > self._config.squat_min * self._height, text

    def _wave(self, loop: ClosedLoop) -> tuple[bool, str]:
        reduced = self._move(loop, "wave")
        hands = [self._model.frame_id(name) for name in ("l_wrist", "r_wrist")]
        heights = []
        for q in loop.log.true_q[::10]:
            pin.framesForwardKinematics(self._model.pin, self._data, q)
            heights.append([float(self._data.oMf[hand].translation[2]) for hand in hands])
        raised = float(np.max(np.array(heights) - heights[0]))
        text = f"hand rose {100.0 * raised:.0f} cm{reduced}, {self._effort(loop)}"
        return raised > self._config.hand_min * self._height, text

    def _move(self, loop: ClosedLoop, name: str) -> str:
        """Play a motion; returns how it was reduced. ``PoiseError`` when it does not end with a standing robot."""
        size = self._command(loop, name).details.get("size", 1.0)
        if not loop.wait_motion():
            raise PoiseError(self._why(loop, "the motion did not end"))
        loop.run(self._config.pause)
        if not self._standing(loop):
            raise PoiseError(self._why(loop, "the robot did not stand after the motion"))
        return "" if size == 1.0 else f" at {100.0 * size:.0f} % of the motion's size"

    def _walk(self, loop: ClosedLoop) -> tuple[bool, str]:
        start = loop.truth.q[:2].copy()
        self._command(loop, "walk")
        gait = loop.gait.config
        speed = min(self._config.walk_speed * gait.pace.forward, gait.velocity.forward)
        loop.set_velocity(speed, 0.0, 0.0)
        loop.run(self._config.walk_time)
        if loop.mode is Mode.WALK:
            loop.command("stop")
            loop.run(self._config.stop_time)
        way = float(np.linalg.norm(loop.truth.q[:2] - start))
        if not self._standing(loop) or way < self._config.stride_min * self._height:
            return False, self._why(loop, f"the robot walked {way:.2f} m")
        swings = loop.log.swing
        steps = int(np.count_nonzero((swings[1:] >= 0) & (swings[1:] != swings[:-1])))
        return True, f"{way:.2f} m in {steps} steps at {speed:.2f} m/s, {self._effort(loop)}"

    def _push(self, loop: ClosedLoop) -> tuple[bool, str]:
        """Push the robot from behind, from the right, from the front and from the left."""
        size, duration = self._config.push, self._config.push_time
        for angle in np.radians((0.0, 90.0, 180.0, 270.0)).tolist():
            force = self._model.mass * size / duration
            loop.apply_push((force * np.cos(angle), force * np.sin(angle), 0.0), duration)
            loop.run(self._config.push_pause)
            if not self._standing(loop):
                return False, self._why(loop, f"the robot does not stand {self._config.push_pause:g} s after the push")
        return True, f"{size:g} m/s from four sides, {self._effort(loop)}"

    def _command(self, loop: ClosedLoop, text: str) -> CommandReply:
        if not (reply := loop.command(text)).accepted:
            raise PoiseError(reply.reason)
        return reply

    def _standing(self, loop: ClosedLoop) -> bool:
        return loop.mode is Mode.STAND and not loop.fallen

    def _effort(self, loop: ClosedLoop) -> str:
        """The joint with the highest torque relative to its limit in the trial."""
        shares = np.abs(loop.log.tau) / self._model.tau_max
        joint = int(shares.max(axis=0).argmax())
        return f"'{self._model.joint_names[joint]}' at {100.0 * shares[:, joint].max():.0f} % of its torque"

    def _why(self, loop: ClosedLoop, otherwise: str) -> str:
        """Cause of a failure: faults, kind of fall, or ``otherwise``; and the first joint at its torque limit."""
        shares = np.abs(loop.log.tau) / self._model.tau_max
        end = next((i for i, mode in enumerate(loop.log.modes) if mode is Mode.DAMP), len(shares))
        reasons = list(loop.faults) or ([loop.fall_reason] if loop.fallen else [otherwise])
        full = shares[:end] > self._config.at_limit
        if full.any():
            row = int(full.any(axis=1).argmax())
            joint = int(shares[row].argmax())
            ahead = float(loop.log.t[end - 1] - loop.log.t[row])
            name, limit = self._model.joint_names[joint], self._model.tau_max[joint]
            reasons.append(
                f"joint '{name}' was the first at its torque limit of {limit:g} N.m, {ahead:.2f} s before the end"
            )
        return "; ".join(reasons)


NEEDED = ("stand", "wave")  #: Required trials, as far as the robot can perform them
_PLANNED = ("squat", "wave")  #: Motions that a standing posture should allow
_LISTED = 4  #: Maximum number of names in a cell of the table


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result for a robot: proposal, written files (the profile first), trials, and limits and warnings (``notes``)."""

    proposal: Proposal
    files: tuple[Path, ...]
    trials: tuple[Trial, ...]
    armed: bool = True  # a joint moves a hand against the torso
    notes: tuple[str, ...] = ()

    @property
    def needed(self) -> tuple[str, ...]:
        """Required trials; a robot without arms need not wave."""
        return NEEDED if self.armed else NEEDED[:1]

    @property
    def passed(self) -> bool:
        """Whether the robot stands, and waves if it has an arm."""
        done = {trial.name for trial in self.trials if trial.passed}
        return done.issuperset(self.needed)


def check_robot(
    urdf: Path, out: Path, packages: Sequence[Path] = (), *, overwrite: bool = False, seed: int = 0
) -> Verdict:
    """Propose a profile for a URDF or MJCF, write it to ``out``, and try it; ``overwrite`` replaces a file."""
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already: give another file with --out, or --overwrite")
    with warnings.catch_warnings(record=True, action="always") as caught:  # warnings about omitted shapes
        proposal, files = propose_profile(urdf, out, packages)
        model = RobotModel.load(files[0])
        trials = Trials(model, default_config(TrialConfig, "bridge", "check_robot"), seed)
        drawn, stood, *others = _draw(model), *trials.run()
        if proposal.unmet is not None and not stood.passed:
            stood = replace(stood, detail=f"{proposal.unmet.culprit}: {proposal.unmet.fault}; {stood.detail}")
        done = drawn, stood, *others
        limits = trials.limits if stood.passed else []
        notes = dict.fromkeys((*limits, *(str(each.message) for each in caught)))
    return Verdict(proposal, tuple(files), done, bool(arms(model)), tuple(notes))


def propose_profile(urdf: Path, out: Path, packages: Sequence[Path]) -> tuple[Proposal, list[Path]]:
    """Propose a profile with the first hand position that allows the largest motions; returns it with its files."""
    config = default_config(ProposalConfig, "models", "proposal")
    found: list[tuple[float, Proposal]] = []
    for hand in config.posture.hands:
        one_hand = replace(config, posture=replace(config.posture, hands=(hand,)))
        proposal = propose(urdf, packages, one_hand)
        model = RobotModel.load(write_proposal(proposal, out)[0])
        found.append((_size(model), proposal))
        if found[-1][0] == 1.0 or not arms(model):
            break
    proposal = max(found, key=lambda each: each[0])[1]
    return proposal, write_proposal(proposal, out)


def _size(model: RobotModel) -> float:
    """Smallest feasible scale of the planned motions, at most 1; 0 when one cannot be planned."""
    try:
        planner = MotionPlanner(model)
        return min(planner.plan_sized(motion, model.posture("stand"))[1] for motion in _PLANNED)
    except PoiseError:
        return 0.0


def _draw(model: RobotModel) -> Trial:
    try:
        drawn = build_mujoco(model, visuals=True).model
    except PoiseError as error:
        return Trial("draw", False, str(error))
    return Trial("draw", True, f"{drawn.nmesh} meshes, {drawn.ngeom} geoms")


def shortened(culprit: str) -> str:
    """The first few of many names; the header of the profile lists all."""
    names = culprit.split(", ")
    more = len(names) - _LISTED
    return culprit if more < 2 else f"{', '.join(names[:_LISTED])} and {more} more"


def report(verdict: Verdict, console: Console) -> None:
    """Print figures, findings and trials as tables, and the verdict in one line."""
    proposal, profile = verdict.proposal, verdict.proposal.profile
    figures = Table("robot", escape(profile.name), show_header=True)
    x_min, x_max, y_min, y_max = profile.feet.left.rectangle
    for name, text in (
        ("base", profile.base_link),
        ("feet", f"{profile.feet.left.link}, {profile.feet.right.link}"),
        ("sole", f"{100 * (x_max - x_min):.1f} x {100 * (y_max - y_min):.1f} cm"),
        ("mass, CoM height", f"{proposal.mass:.1f} kg, {proposal.com_height:.3f} m"),
        ("joints, mirror pairs", f"{len(profile.joints)}, {len(proposal.pairs)}"),
        *((name, frame.link) for name, frame in profile.frames.items()),
    ):
        figures.add_row(name, escape(text))
    console.print(figures)
    if proposal.findings:
        findings = Table("", "part", "finding", "remedy")
        for finding in sorted(proposal.findings, key=lambda finding: finding.severity, reverse=True):
            style = "red" if finding.severity == "wrong" else "yellow"
            cells = (finding.severity, shortened(finding.culprit), finding.fault, finding.remedy)
            findings.add_row(*(escape(cell) for cell in cells), style=style)
        console.print(findings)
    trials = Table("trial", "", "result, or cause of the failure")
    for trial in verdict.trials:
        word = "[green]done[/green]" if trial.passed else "[red]failed[/red]"
        trials.add_row(trial.name, word, escape(trial.detail))
    console.print(trials)
    for note in verdict.notes:
        console.print(f"- {note}", style="yellow", markup=False)
    done = " and ".join(f"{trial}s" for trial in verdict.needed)
    done = done if verdict.passed else f"does not {' and '.join(verdict.needed)}"
    files = ", ".join(str(file) for file in verdict.files)
    console.print(f"{profile.name} {done}: {files}", style="green" if verdict.passed else "red", markup=False)
