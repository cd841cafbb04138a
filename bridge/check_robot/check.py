"""``poise check-robot``: propose a profile for a URDF, try it in the closed loop, and report errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bridge.check_robot.trials import Trial, TrialConfig, Trials
from models.config import default_config
from models.errors import ConfigError, PoiseError
from models.mujoco_model import build_mujoco
from models.proposal.config import ProposalConfig
from models.proposal.profile_text import write_proposal
from models.proposal.propose import Proposal, propose
from models.robot_model import RobotModel
from planners.motion import MotionPlanner

NEEDED = ("stand", "wave")  #: Required trials
_PLANNED = ("squat", "wave")  #: Motions that a standing posture should allow
_LISTED = 4  #: Names that a cell of the table lists


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result for a URDF: profile and findings, files written (the profile first), and trials."""

    proposal: Proposal
    files: tuple[Path, ...]
    trials: tuple[Trial, ...]

    @property
    def passed(self) -> bool:
        """Whether the robot stands and waves."""
        done = {trial.name for trial in self.trials if trial.passed}
        return done.issuperset(NEEDED)


def check_robot(
    urdf: Path, out: Path, packages: Sequence[Path] = (), *, overwrite: bool = False, seed: int = 0
) -> Verdict:
    """Propose a profile for a URDF, write it and try it.

    The profile is written to ``out``, which is replaced only with ``overwrite``, a changed URDF next to it.
    ``packages`` are folders searched first for ``package://``; ``seed`` is of the sensor noise. Raises
    ``RobotModelError`` with file, joint or link when the URDF cannot become a robot that stands, ``ConfigError`` when
    ``out`` exists.
    """
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already: give another name with --out, or --overwrite")
    proposal, files = _propose(urdf, out, packages)
    model = RobotModel.load(files[0])
    trials = [_draw(model), *Trials(model, default_config(TrialConfig, "bridge", "check_robot"), seed).run()]
    return Verdict(proposal, tuple(files), tuple(trials))


def _propose(urdf: Path, out: Path, packages: Sequence[Path]) -> tuple[Proposal, list[Path]]:
    """Propose with the first place of the hands for which all motions can be planned; otherwise with the first."""
    config = default_config(ProposalConfig, "models", "proposal")
    for hand in config.posture.hands:
        first = replace(config, posture=replace(config.posture, hands=(hand,)))
        proposal = propose(urdf, packages, first)
        files = write_proposal(proposal, out)
        if _plannable(RobotModel.load(files[0])):
            return proposal, files
    proposal = propose(urdf, packages, config)
    return proposal, write_proposal(proposal, out)


def _plannable(model: RobotModel) -> bool:
    try:
        planner = MotionPlanner(model)
        for motion in _PLANNED:
            planner.plan(motion, model.posture("stand"))
    except PoiseError:
        return False
    return True


def _draw(model: RobotModel) -> Trial:
    """Whether MuJoCo loads the robot with its meshes, which pictures need."""
    try:
        drawn = build_mujoco(model, visuals=True).model
    except PoiseError as error:
        return Trial("draw", False, str(error))
    return Trial("draw", True, f"{drawn.nmesh} meshes, {drawn.ngeom} geoms")


def shortened(culprit: str) -> str:
    """The first few of many names; the profile's head has all of them."""
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
        findings = Table("", "whose", "what", "remedy")
        for finding in sorted(proposal.findings, key=lambda finding: finding.severity, reverse=True):
            style = "red" if finding.severity == "wrong" else "yellow"
            cells = (finding.severity, shortened(finding.culprit), finding.fault, finding.remedy)
            findings.add_row(*(escape(cell) for cell in cells), style=style)
        console.print(findings)
    trials = Table("trial", "", "figures, or what stopped it")
    for trial in verdict.trials:
        word = "[green]done[/green]" if trial.passed else "[red]failed[/red]"
        trials.add_row(trial.name, word, escape(trial.detail))
    console.print(trials)
    done = "stands and waves" if verdict.passed else "does not stand and wave"
    files = ", ".join(str(file) for file in verdict.files)
    console.print(f"{profile.name} {done}: {files}", style="green" if verdict.passed else "red", markup=False)
