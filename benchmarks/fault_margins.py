"""How late joint states may come for good before the robot no longer rides through: the delay margin."""

from __future__ import annotations

from benchmarks.fault_rows import Row, config
from benchmarks.fault_trial import trial
from benchmarks.harness import Case
from benchmarks.push_search import largest


def margin(robot: str, seed: int, row: str) -> Case:
    """Bisect the delay that the robot just rides through.

    Args:
        robot: Name of a profile.
        seed: Of the sensor noise.
        row: Name of the margin.

    Returns:
        A row of the table, with ``margin`` [s]: the largest delay found that holds; ``reason`` is what was told at the
        smallest that does not. ``ok`` when the margin is at least the one that is required.
    """
    given = config()
    wanted, told, steps = given.margins[row], "", [0.0]

    def holds(delay: float) -> bool:
        nonlocal told
        fault = {"target": "joint_states", "kind": "delayed", "delay": delay}
        case = trial(robot, seed, Row(group=wanted.group, walk=wanted.walk, expect="rides", faults=[fault]))
        if case["ok"]:
            steps.append(case["torque_step"])
        else:
            told = f"then {case['seen']}, {case['reason']}"
        return bool(case["ok"])

    found, _ = largest(holds, given.delays)
    return {
        "group": wanted.group,
        "expected": f"rides at {wanted.required:.4f} s",
        "within": None,
        "seen": f"rides up to {found:.4f} s",
        "reason": told,
        "time": None,
        "torque_step": max(steps),
        "margin": found,
        "ok": found >= wanted.required,
    }
